// A run that goes on: what is played is the newest stretch of it, and then the one after that.

const PATIENCE = 1000; // ms between two questions at least
const note = byId("live");
let askedAt = 0;
let timer = null;

function begin(packed) {
  take(packed);
  document.title = byId("title").textContent = packed.title;
  byId("lead").textContent = packed.lead;
  note.textContent = "Live: the newest seconds, then those after them. Pause to stay with these.";
  byId("position").max = String(count - 1);
  [playing, before] = [true, null];
  redraw();
}

function soon() {
  clearTimeout(timer);
  timer = setTimeout(ask, Math.max(askedAt + PATIENCE - Date.now(), 0));
}

async function ask() {
  if (position < count - 1) return; // somebody has gone back to look
  askedAt = Date.now();
  try {
    const last = `deployment=${timeline.deployment}&step=${numbers[count - 1]}`;
    const answer = await fetch(`newest?${last}`);
    if (answer.status === 200) {
      begin(await answer.json());
      return;
    }
    note.textContent = (await answer.text()) || "Live: no newer step yet.";
  } catch {
    note.textContent = "Nobody answers: the run has ended, or the view.";
  }
  soon();
}

note.hidden = false;
atEnd = soon;
begin(timeline);
