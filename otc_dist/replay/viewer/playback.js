// Moving through the timeline: playing, dragging, keys, links.

let asked = false;
let atEnd = () => {}; // what else happens where it has played to the end

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
    position += ((now - before) / 1000 / timeline.seconds) * speed;
    const ends = position >= count - 1;
    if (ends) [position, playing] = [count - 1, false];
    follow();
    if (ends) atEnd();
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
