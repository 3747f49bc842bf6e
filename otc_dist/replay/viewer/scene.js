// The scene: bodies at the cursor, between two steps where it plays.

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
