// The plots: episodes, rewards, returns and actions over the steps, under one cursor.

// Each: what is over the steps, by a function that gives lines [name, colour, dash, value of step i].
const charts = [];
const dashes = [[], [6, 3], [2, 3], [8, 3, 2, 3]];

function chart(title, of, { fixed = null, say = format, plot = drawLines, look = "" } = {}) {
  const canvas = document.createElement("canvas");
  canvas.className = look;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${title} over the steps`);
  byId("plots").append(canvas);
  charts.push({ title, of, fixed, say, plot, canvas });
}

function ofAgents(values) {
  if (shared) return [["team", [125, 134, 146], [], (i) => values[i * team]]];
  return timeline.agents.map((agent, n) =>
    [agent.name, agent.colour, dashes[Math.floor(n / 6) % 4], (i) => values[i * team + n]]);
}

chart("", () => [], { plot: drawSteps, look: "steps" });
chart("reward", () => ofAgents(rewards));
chart("return so far", () => ofAgents(returns));
for (const [n, agent] of timeline.agents.entries()) {
  const size = agent.low.length;
  const lines = () => agent.low.map((_, j) =>
    [size > 1 ? `[${j}]` : "", agent.colour, dashes[j % 4], (i) => actions[n][i * size + j]]);
  const fixed = [Math.min(...agent.low), Math.max(...agent.high)];
  // Choices have no order that a height could show: each has a colour of its own.
  if (agent.choices) chart(agent.name, lines, { say: choice, plot: drawStrip, look: "strip" });
  else chart(`${agent.name}: action`, lines, { fixed });
}

if (timeline.choices.length) {
  const key = document.createElement("p");
  key.className = "key";
  for (const [action, rgb] of timeline.choices.entries()) {
    const item = document.createElement("span");
    const patch = document.createElement("i");
    patch.style.background = colour(rgb);
    item.append(patch, choice(action));
    key.append(item);
  }
  byId("plots").append(key);
}

const [LEFT, RIGHT, TOP, BOTTOM] = [64, 12, 22, 8];

// What does not change with the cursor is drawn once, and then copied.
function drawChart(chart) {
  const { title, of, say, plot, canvas } = chart;
  const lines = of();
  const { context, width, height } = fit(canvas);
  const style = styles();
  const kept = [...shown, canvas.width, canvas.height, style.getPropertyValue("--line")].join();
  if (chart.kept !== kept || chart.drawn !== timeline) {
    chart.layer ??= document.createElement("canvas");
    plot({ ...chart, lines }, style);
    [chart.kept, chart.drawn] = [kept, timeline];
  }
  context.drawImage(chart.layer, 0, 0, width, height);

  context.font = "12px system-ui, sans-serif";
  context.fillStyle = style.getPropertyValue("--text");
  context.fillText(title, LEFT, 15);
  let from = LEFT + context.measureText(title).width + 18;
  const i = at();
  for (const [name, rgb, dash, value] of lines) {
    context.strokeStyle = colour(plot === drawStrip ? choiceRgb(value(i)) : rgb);
    context.setLineDash(dash);
    context.lineWidth = plot === drawStrip ? 9 : 1.5;
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
  context.lineWidth = 1.5;
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

// What is shown of the timeline on a canvas: its places begin..end, and where place i lies.
function across(width) {
  const [first, last] = shown;
  const [begin, end] = [Math.max(Math.floor(first), 0), Math.min(Math.ceil(last), count - 1)];
  const x = (i) => LEFT + ((i - first) / (last - first)) * (width - LEFT - RIGHT);
  const within = (i) => clamp(x(i), LEFT, width - RIGHT);
  return { begin, end, x, within };
}

// Every second episode is shaded, as far as they can be distinguished.
function shade(context, style, width, top, bottom, dark = 0.45) {
  const { begin, end, within } = across(width);
  const [from, to] = [episodeAt(begin), episodeAt(end)];
  if (to - from > width / 8) return;
  context.fillStyle = style.getPropertyValue("--line");
  context.globalAlpha = dark;
  for (let n = from; n <= to; n++) {
    const [left, right] = [within(starts[n] - 0.5), within((starts[n + 1] ?? count) - 0.5)];
    if (n % 2) context.fillRect(left, top, right - left, bottom - top);
  }
  context.globalAlpha = 1;
  context.strokeStyle = style.getPropertyValue("--ground");
  context.setLineDash([3, 3]);
  context.beginPath();
  for (let n = from + 1; n <= to; n++) {
    context.moveTo(within(starts[n] - 0.5), top);
    context.lineTo(within(starts[n] - 0.5), bottom);
  }
  context.stroke();
  context.setLineDash([]);
}

// Which episode is where, and the numbers of the steps.
function drawSteps({ canvas, layer }, style) {
  const { context, width } = fit(layer, canvas);
  const { begin, end, x, within } = across(width);
  shade(context, style, width, 4, 24, 1);
  context.strokeStyle = style.getPropertyValue("--ground");
  context.strokeRect(LEFT, 4, width - LEFT - RIGHT, 20);
  context.font = "12px system-ui, sans-serif";
  context.fillStyle = style.getPropertyValue("--muted");
  context.textAlign = "right";
  context.fillText("episode", LEFT - 8, 18);
  context.fillText("step", LEFT - 8, 40);
  context.textAlign = "center";
  for (let n = episodeAt(begin); n <= episodeAt(end); n++) {
    const [left, right] = [within(starts[n] - 0.5), within((starts[n + 1] ?? count) - 0.5)];
    const text = timeline.names[n].replace(/^.*its (.*) episode$/, "$1"); // the copy is the same
    const fits = context.measureText(text).width < right - left - 8;
    if (fits) context.fillText(text, (left + right) / 2, 18);
  }
  const step = [1, 2, 5].map((m) => m * 10 ** Math.floor(Math.log10((end - begin) / 4 + 1)));
  const every = step.find((s) => (end - begin) / s <= width / 90) || 10 * step[0];
  let before = -Infinity;
  for (let i = begin; i <= end; i++) {
    if (numbers[i] % every || x(i) < LEFT || x(i) > width - RIGHT || x(i) - before < 30) continue;
    before = x(i);
    context.fillText(String(numbers[i]), x(i), 40);
    context.fillRect(x(i), 24, 1, 4);
  }
}

// A choice is a stretch in its colour.
function drawStrip({ lines, canvas, layer }, style) {
  const { context, width, height } = fit(layer, canvas);
  const { begin, end, within } = across(width);
  const value = lines[0][3];
  let from = begin;
  for (let i = begin; i <= end; i++) {
    if (i < end && value(i + 1) === value(from) && !begins.has(i + 1)) continue;
    context.fillStyle = colour(choiceRgb(value(from)));
    const left = within(from - 0.5);
    context.fillRect(left, TOP, Math.max(within(i + 0.5) - left, 0.5), height - TOP - 4);
    from = i + 1;
  }
  shade(context, style, width, TOP - 3, height - 1, 0);
}

function drawLines({ lines, fixed, canvas, layer }, style) {
  const { context, width, height } = fit(layer, canvas);
  const { begin, end, x } = across(width);
  const [low, high] = fixed || range(lines, begin, end);
  const y = (v) =>
    height - BOTTOM - ((clamp(v, low, high) - low) / (high - low)) * (height - TOP - BOTTOM);

  shade(context, style, width, TOP, height - BOTTOM);
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
