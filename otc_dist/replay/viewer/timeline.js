"use strict";
// The timeline: arrays over T steps, as `otc_dist.replay.html` packed them, and the numbers beside
// the scene. The other scripts follow after it in the same page.

function unpack(packed, Kind) {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  return new Kind(bytes.buffer);
}

let timeline, numbers, episodes, rewards, returns, actions, exploring, scene, poses, levels;
let count; // T
let team; // agents
let shared; // whether all agents have the same rewards
let starts; // the steps at which episodes begin, as places on the timeline
let begins;
let shown; // what the plots show of the timeline
let position; // on the timeline; between two steps while it plays

// Show a timeline from its beginning.
function take(packed) {
  timeline = packed;
  numbers = unpack(timeline.numbers, Int32Array);
  episodes = unpack(timeline.episodes, Int32Array);
  rewards = unpack(timeline.rewards, Float32Array); // T x agents
  returns = unpack(timeline.returns, Float32Array);
  actions = timeline.agents.map((agent) => unpack(agent.actions, Float32Array));
  exploring = unpack(timeline.exploring, Uint8Array);
  scene = timeline.scene;
  poses = scene && unpack(scene.poses, Float32Array); // T x bodies x (u, v, angle)
  levels = scene && unpack(scene.levels, Float32Array); // T x bodies
  count = numbers.length;
  team = timeline.agents.length;
  shared = rewards.every((reward, k) => reward === rewards[k - (k % team)]);
  starts = [];
  for (let i = 0; i < count; i++) {
    if (i === 0 || episodes[i] !== episodes[i - 1] || numbers[i] !== numbers[i - 1] + 1) {
      starts.push(i);
    }
  }
  begins = new Set(starts);
  shown = [0, Math.max(count - 1, 1)];
  position = 0;
}

take(JSON.parse(document.getElementById("timeline").textContent));

const episodeAt = (i) => starts.findLastIndex((start) => start <= i); // as places in `starts`

const byId = (id) => document.getElementById(id);
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const styles = () => getComputedStyle(document.documentElement);

let playing = false;
let speed = 1; // of the task's own time

function format(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const digits = size >= 1000 || size === 0 ? 0 : size >= 100 ? 1 : size >= 1 ? 2 : 3;
  return value.toFixed(digits).replace("-", "−");
}

const choiceRgb = (action) => timeline.choices[action] || [125, 134, 146];
const choice = (action) => (scene && scene.choices[action]) || `choice ${action}`;

const at = () => clamp(Math.floor(position + 1e-6), 0, count - 1);

function mean(values, i) {
  let sum = 0;
  for (let n = 0; n < team; n++) sum += values[i * team + n];
  return sum / team;
}

const bars = [];
for (const [n, agent] of timeline.agents.entries()) {
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
  byId("episode").textContent = timeline.names[episodeAt(i)];
  byId("reward").textContent = format(mean(rewards, i));
  byId("return").textContent = format(mean(returns, i));
  for (const { reward, rows, n } of bars) {
    const agent = timeline.agents[n];
    reward.textContent =
      `reward ${format(rewards[i * team + n])}` + (exploring[i * team + n] ? ", exploring" : "");
    for (const [j, { fill, value }] of rows.entries()) {
      const action = actions[n][i * rows.length + j];
      const [low, high] = [agent.low[j], agent.high[j]];
      if (agent.choices) {
        [fill.style.left, fill.style.width] = ["0%", "100%"];
        fill.style.background = colour(choiceRgb(action));
        value.textContent = choice(action);
        continue;
      }
      const place = (x) => (100 * (clamp(x, low, high) - low)) / (high - low || 1);
      const zero = place(0);
      const end = place(action);
      fill.style.left = `${Math.min(zero, end)}%`;
      fill.style.width = `${Math.abs(end - zero)}%`;
      value.textContent = format(action);
    }
  }
}
