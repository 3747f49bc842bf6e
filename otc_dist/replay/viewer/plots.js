// The plots: rewards, returns and actions over the steps, under one cursor.

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
