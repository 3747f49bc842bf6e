"use strict";
// The tape: arrays over T steps, as `otc_dist.replay.html` packed them.

const tape = JSON.parse(document.getElementById("tape").textContent);

function unpack(packed, Kind) {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  return new Kind(bytes.buffer);
}

const numbers = unpack(tape.numbers, Int32Array);
const episodes = unpack(tape.episodes, Int32Array);
const rewards = unpack(tape.rewards, Float32Array); // T x agents
const returns = unpack(tape.returns, Float32Array);
const actions = tape.agents.map((agent) => unpack(agent.actions, Float32Array));
const exploring = unpack(tape.exploring, Uint8Array);
const scene = tape.scene;
const poses = scene && unpack(scene.poses, Float32Array); // T x bodies x (u, v, angle)
const levels = scene && unpack(scene.levels, Float32Array); // T x bodies
const count = numbers.length;
const team = tape.agents.length;

const starts = []; // the steps at which episodes begin, as places on the tape
for (let i = 0; i < count; i++) {
  if (i === 0 || episodes[i] !== episodes[i - 1] || numbers[i] !== numbers[i - 1] + 1) {
    starts.push(i);
  }
}

const begins = new Set(starts);

const byId = (id) => document.getElementById(id);
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const styles = () => getComputedStyle(document.documentElement);

let position = 0; // on the tape; between two steps while it plays
let playing = false;
let speed = 1; // of the task's own time
let shown = [0, Math.max(count - 1, 1)]; // what the plots show of the tape

// ---- Text

function format(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const digits = size >= 1000 || size === 0 ? 0 : size >= 100 ? 1 : size >= 1 ? 2 : 3;
  return value.toFixed(digits).replace("-", "−");
}

const choice = (action) => (scene && scene.choices[action]) || `choice ${action}`;

const at = () => clamp(Math.floor(position + 1e-6), 0, count - 1);

function mean(values, i) {
  let sum = 0;
  for (let n = 0; n < team; n++) sum += values[i * team + n];
  return sum / team;
}

const bars = [];
for (const [n, agent] of tape.agents.entries()) {
  const box = document.createElement("div");
  box.className = "agent";
  const heading = document.createElement("h2");
  const name = document.createElement("span");
  const dot = document.createElement("span");
  dot.className = "dot";
  dot.style.background = colour(agent.colour);
  name.append(dot, agent.name);
  const reward = document.createElement("i");
  heading.append(name, reward);
  box.append(heading);
  const rows = [];
  for (let j = 0; j < agent.low.length; j++) {
    const row = document.createElement("div");
    row.className = "action";
    const bar = document.createElement("div");
    bar.className = "bar";
    const fill = document.createElement("b");
    fill.style.background = colour(agent.colour);
    bar.append(fill);
    const value = document.createElement("span");
    value.className = "value";
    row.append(bar, value);
    box.append(row);
    rows.push({ fill, value });
  }
  byId("agents").append(box);
  bars.push({ reward, rows, n });
}

function showNow(i) {
  byId("step").textContent = String(numbers[i]);
  byId("episode").textContent = String(episodes[i]);
  byId("reward").textContent = format(mean(rewards, i));
  byId("return").textContent = format(mean(returns, i));
  for (const { reward, rows, n } of bars) {
    const agent = tape.agents[n];
    reward.textContent =
      `reward ${format(rewards[i * team + n])}` + (exploring[i * team + n] ? ", exploring" : "");
    for (const [j, { fill, value }] of rows.entries()) {
      const action = actions[n][i * rows.length + j];
      const [low, high] = [agent.low[j], agent.high[j]];
      const place = (x) => (100 * (clamp(x, low, high) - low)) / (high - low || 1);
      const zero = agent.choices ? 0 : place(0);
      const end = place(action);
      fill.style.left = `${Math.min(zero, end)}%`;
      fill.style.width = `${Math.abs(end - zero)}%`;
      value.textContent = agent.choices ? choice(action) : format(action);
    }
  }
}

// ---- The scene

function colour(rgb, opacity = 1) {
  return `rgba(${rgb[0]}, ${rgb[1]}, ${rgb[2]}, ${opacity})`;
}

// A canvas as large as its place, cleared, to be drawn on in CSS pixels.
function fit(canvas, place = canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { width, height } = place.getBoundingClientRect();
  const size = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

// The pose of a body: between two steps of one episode it moves evenly.
function pose(body, i, share) {
  const bodies = scene.bodies.length;
  const from = (i * bodies + body) * 3;
  const to = share > 0 && i + 1 < count && !begins.has(i + 1) ? from + 3 * bodies : from;
  const turn = poses[to + 2] - poses[from + 2];
  const nearest = turn - 2 * Math.PI * Math.round(turn / (2 * Math.PI));
  return [
    poses[from] + share * (poses[to] - poses[from]),
    poses[from + 1] + share * (poses[to + 1] - poses[from + 1]),
    poses[from + 2] + share * nearest,
  ];
}

function drawScene() {
  const { context, width, height } = fit(byId("scene"));
  const style = styles();
  const view = scene.view;
  const i = at();
  const share = clamp(position - i, 0, 1);
  const scale = Math.min(width / view.width, height / view.height);
  const middle = view.follows === null ? view.centre[0] : pose(view.follows, i, share)[0] || 0;
  const x = (u) => width / 2 + (u - middle) * scale;
  const y = (v) => height / 2 - (v - view.centre[1]) * scale;

  context.strokeStyle = style.getPropertyValue("--ground");
  context.fillStyle = style.getPropertyValue("--muted");
  context.lineWidth = 1.5;
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "center";
  context.beginPath();
  if (view.follows === null) {
    for (const [u, v] of view.outline) context.lineTo(x(u), y(v));
    context.closePath();
  } else {
    context.moveTo(0, y(0));
    context.lineTo(width, y(0));
    const reach = width / 2 / scale;
    for (let metre = Math.ceil(middle - reach); metre <= middle + reach; metre++) {
      context.moveTo(x(metre), y(0));
      context.lineTo(x(metre), y(0) + 7);
      context.fillText(`${metre} m`, x(metre), y(0) + 20);
    }
  }
  context.stroke();

  for (const [number, body] of scene.bodies.entries()) {
    const level = levels[i * scene.bodies.length + number];
    const [u, v, angle] = pose(number, i, share);
    if (!(level > 0) || !Number.isFinite(u + v + angle)) continue;
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    for (const [a, b, d, e, radius] of body.capsules) {
      context.beginPath();
      context.lineCap = "round";
      if (body.solid) {
        context.strokeStyle = colour(body.colour, 0.35 + 0.65 * level);
        context.lineWidth = 2 * radius * scale;
        context.moveTo(x(u + c * a - s * b), y(v + s * a + c * b));
        // A stretch without length is not drawn, however thick it is.
        context.lineTo(x(u + c * d - s * e) + 0.01, y(v + s * d + c * e));
      } else {
        context.strokeStyle = colour(body.colour);
        context.lineWidth = 2;
        context.setLineDash([5, 4]);
        context.arc(x(u), y(v), radius * scale, 0, 2 * Math.PI);
      }
      context.stroke();
      context.setLineDash([]);
      if (level < 1) {
        context.lineCap = "butt";
        context.strokeStyle = colour(body.colour);
        context.lineWidth = 4;
        context.beginPath();
        context.moveTo(x(u - radius), y(v + radius) - 6);
        context.lineTo(x(u - radius + 2 * radius * level), y(v + radius) - 6);
        context.stroke();
      }
    }
  }
}

// ---- The plots

// Each: what is over the steps, as lines [name, colour, dash, value of step i].
const charts = [];
const shared = rewards.every((reward, k) => reward === rewards[k - (k % team)]);
const dashes = [[], [6, 3], [2, 3], [8, 3, 2, 3]];

function chart(title, lines, fixed = null, say = format) {
  const canvas = document.createElement("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${title} over the steps`);
  byId("plots").append(canvas);
  charts.push({ title, lines, fixed, say, canvas });
}

function ofAgents(values) {
  if (shared) return [["team", [125, 134, 146], [], (i) => values[i * team]]];
  return tape.agents.map((agent, n) =>
    [agent.name, agent.colour, dashes[Math.floor(n / 6) % 4], (i) => values[i * team + n]]);
}

chart("reward", ofAgents(rewards));
chart("return so far", ofAgents(returns));
for (const [n, agent] of tape.agents.entries()) {
  const size = agent.low.length;
  const lines = agent.low.map((_, j) =>
    [size > 1 ? `[${j}]` : "", agent.colour, dashes[j % 4], (i) => actions[n][i * size + j]]);
  const fixed = [Math.min(...agent.low), Math.max(...agent.high)];
  if (agent.choices) chart(`${agent.name}: choice`, lines, fixed, choice);
  else chart(`${agent.name}: action`, lines, fixed);
}

const [LEFT, RIGHT, TOP, BOTTOM] = [64, 12, 22, 8];

// What does not change with the cursor is drawn once, and then copied.
function drawChart(chart) {
  const { title, lines, say, canvas } = chart;
  const { context, width, height } = fit(canvas);
  const style = styles();
  const kept = [...shown, canvas.width, canvas.height, style.getPropertyValue("--line")].join();
  if (chart.kept !== kept) {
    chart.layer ??= document.createElement("canvas");
    drawLines(chart, style);
    chart.kept = kept;
  }
  context.drawImage(chart.layer, 0, 0, width, height);

  context.font = "12px system-ui, sans-serif";
  context.fillStyle = style.getPropertyValue("--text");
  context.fillText(title, LEFT, 15);
  let from = LEFT + context.measureText(title).width + 18;
  const i = at();
  for (const [name, rgb, dash, value] of lines) {
    context.strokeStyle = colour(rgb);
    context.setLineDash(dash);
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(from, 11);
    context.lineTo(from + 20, 11);
    context.stroke();
    const text = `${name} ${say(value(i))}`.trim();
    context.fillStyle = style.getPropertyValue("--muted");
    context.fillText(text, from + 25, 15);
    from += 43 + context.measureText(text).width;
  }
  context.setLineDash([]);
  context.strokeStyle = style.getPropertyValue("--accent");
  context.beginPath();
  const x = LEFT + ((position - shown[0]) / (shown[1] - shown[0])) * (width - LEFT - RIGHT);
  context.moveTo(x, TOP - 4);
  context.lineTo(x, height - BOTTOM + 4);
  context.stroke();
}

function range(lines, begin, end) {
  let [low, high] = [Infinity, -Infinity];
  for (const [, , , value] of lines) {
    for (let i = begin; i <= end; i++) {
      const found = value(i);
      if (Number.isFinite(found)) [low, high] = [Math.min(low, found), Math.max(high, found)];
    }
  }
  if (low > high) return [0, 1];
  return low === high ? [low - 0.5, high + 0.5] : [low, high];
}

function drawLines({ lines, fixed, canvas, layer }, style) {
  const { context, width, height } = fit(layer, canvas);
  const [first, last] = shown;
  const [begin, end] = [Math.max(Math.floor(first), 0), Math.min(Math.ceil(last), count - 1)];
  const [low, high] = fixed || range(lines, begin, end);
  const x = (i) => LEFT + ((i - first) / (last - first)) * (width - LEFT - RIGHT);
  const y = (v) =>
    height - BOTTOM - ((clamp(v, low, high) - low) / (high - low)) * (height - TOP - BOTTOM);

  context.font = "12px system-ui, sans-serif";
  context.fillStyle = style.getPropertyValue("--muted");
  context.textAlign = "right";
  context.fillText(format(high), LEFT - 8, y(high) + 8);
  context.fillText(format(low), LEFT - 8, y(low));
  context.strokeStyle = style.getPropertyValue("--line");
  context.beginPath();
  for (const v of [low, high]) {
    context.moveTo(LEFT, y(v));
    context.lineTo(width - RIGHT, y(v));
  }
  const borders = starts.filter((start) => start > first && start <= last);
  for (const start of borders.length < width / 8 ? borders : []) {
    context.moveTo(x(start - 0.5), TOP);
    context.lineTo(x(start - 0.5), height - BOTTOM);
  }
  context.stroke();
  context.lineWidth = 1.5;
  for (const [, rgb, dash, value] of lines) {
    context.strokeStyle = colour(rgb);
    context.setLineDash(dash);
    drawLine(context, value, begin, end, x, y, width);
  }
}

// Where many steps share a pixel, their range is drawn: no peak is lost.
function drawLine(context, value, begin, end, x, y, width) {
  const dense = (end - begin) / width > 2;
  context.beginPath();
  let before = NaN; // the value of the step before, if the line goes on from there
  let column = null;
  const flush = () => {
    if (!column) return;
    context.moveTo(column.x, y(column.low) + 0.5);
    context.lineTo(column.x, y(column.high) - 0.5);
    column = null;
  };
  for (let i = begin; i <= end; i++) {
    const v = value(i);
    if (begins.has(i)) before = NaN;
    if (Number.isFinite(v)) {
      const from = Number.isFinite(before) ? before : v;
      if (!dense) {
        if (from === before) context.lineTo(x(i), y(v));
        else context.moveTo(x(i), y(v));
      } else {
        const place = Math.round(x(i));
        if (!column || column.x !== place) {
          flush();
          column = { x: place, low: from, high: from };
        }
        column.low = Math.min(column.low, v);
        column.high = Math.max(column.high, v);
      }
    }
    before = v;
  }
  flush();
  context.stroke();
}

// ---- Moving through it

let asked = false;

function redraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame((now) => {
    asked = false;
    advance(now);
    draw();
    if (playing) redraw();
  });
}

let before = null;

function advance(now) {
  if (playing && before !== null) {
    position += ((now - before) / 1000 / tape.seconds) * speed;
    if (position >= count - 1) [position, playing] = [count - 1, false];
    follow();
  }
  before = playing ? now : null;
}

function follow() {
  const [first, last] = shown;
  if (position >= first && position <= last) return;
  const half = (last - first) / 2;
  const middle = clamp(position, half, Math.max(count - 1 - half, half));
  shown = [middle - half, middle + half];
}

function draw() {
  byId("position").value = String(position);
  byId("sign").setAttribute("d", playing ? "M3 2h4v12H3zM9 2h4v12H9z" : "M3 2l11 6l-11 6z");
  showNow(at());
  if (scene) drawScene();
  charts.forEach(drawChart);
}

function seek(to) {
  position = clamp(to, 0, count - 1);
  follow();
  redraw();
}

function toggle() {
  playing = !playing;
  if (playing && position >= count - 1) position = 0;
  before = null;
  redraw();
}

function toEpisode(way) {
  const current = starts.filter((start) => start <= position).length - 1;
  const within = way < 0 && position > starts[current] + 0.5 ? 0 : way;
  seek(starts[clamp(current + within, 0, starts.length - 1)]);
}

byId("position").max = String(count - 1);
byId("position").addEventListener("input", (event) => seek(Number(event.target.value)));
byId("play").addEventListener("click", toggle);
byId("earlier").addEventListener("click", () => toEpisode(-1));
byId("later").addEventListener("click", () => toEpisode(1));
for (const value of [0.1, 0.25, 0.5, 1, 2, 5, 20]) {
  byId("speed").append(new Option(`${value} x`, String(value), value === 1, value === 1));
}
byId("speed").addEventListener("change", (event) => { speed = Number(event.target.value); });

const keys = {
  " ": toggle,
  ArrowLeft: (many) => seek(at() - many),
  ArrowRight: (many) => seek(at() + many),
  ArrowUp: () => toEpisode(-1),
  ArrowDown: () => toEpisode(1),
  Home: () => seek(0),
  End: () => seek(count - 1),
};
document.addEventListener("keydown", (event) => {
  if (!(event.key in keys) || event.target.tagName === "SELECT") return;
  event.preventDefault();
  keys[event.key](event.shiftKey ? 10 : 1);
});

for (const { canvas } of charts) {
  const under = (event) => {
    const box = canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return shown[0] + share * (shown[1] - shown[0]);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    seek(under(event));
  });
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons & 1) seek(under(event));
  });
  canvas.addEventListener("dblclick", () => {
    shown = [0, Math.max(count - 1, 1)];
    redraw();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const centre = clamp(under(event), shown[0], shown[1]);
    const factor = Math.exp(event.deltaY / 400);
    const width = clamp((shown[1] - shown[0]) * factor, 10, Math.max(count - 1, 10));
    const share = (centre - shown[0]) / (shown[1] - shown[0]);
    const first = clamp(centre - share * width, 0, Math.max(count - 1 - width, 0));
    shown = [first, first + width];
    redraw();
  }, { passive: false });
}

// A link may name a step: page.html#step=120
function seekLinked() {
  const step = Number(new URLSearchParams(location.hash.slice(1)).get("step"));
  const place = numbers.findIndex((number) => number >= step);
  if (Number.isFinite(step) && place >= 0) seek(place);
}

byId("scene").hidden = !scene;
byId("no-scene").hidden = Boolean(scene);
window.addEventListener("resize", redraw);
window.addEventListener("hashchange", seekLinked);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
seekLinked();
draw();
