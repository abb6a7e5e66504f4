"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const count = data.name.length;
// A baseline that breaks a limit is none to be compared with.
const below = (planned, baseline, faults) => planned.map((value, k) => (value === null || !baseline[k] || faults[k] ? null : 100 * (1 - value / baseline[k])));
const gain = below(data.planned, data.baseline, data.faults), workGain = below(data.workPlanned, data.workBaseline, data.workFaults);
const anyPlace = data.at.some((at) => at !== null);
const place = data.at.map((at, k) => (anyPlace ? at : k + 1));
const element = (id) => document.getElementById(id);
const numbers = (values) => values.filter((value) => value !== null);
const linkOf = (k) => (data.report[k] === null ? null : `${data.plan[k]}/${data.report[k]}`);
const planned = (k) => data.planned[k] !== null;
const digits = (value, number) => (value === null ? "" : value.toFixed(number));
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const COLUMNS = [
  { title: "job", of: (k) => data.name[k] },
  { title: anyPlace ? "at, m" : "number", of: (k) => place[k], digits: anyPlace ? 2 : 0 },
  { title: "ended", of: (k) => data.ended[k] },
  { title: "baseline's peak, Nm", of: (k) => data.baseline[k], digits: 1 },
  { title: "planned peak, Nm", of: (k) => data.planned[k], digits: 1 },
  { title: "reduction, %", of: (k) => gain[k], digits: 1 },
  { title: "at\u00a0work, %", of: (k) => workGain[k], digits: 1 },
  { title: "clearance, mm", of: (k) => (data.clearance[k] === null ? null : 1e3 * data.clearance[k]), digits: 0 },
  { title: "motion, s", of: (k) => data.duration[k], digits: 1 },
  { title: "computed in, s", of: (k) => data.seconds[k], digits: 1 },
];
// A campaign without baselines has no columns of them.
const COMPARED = ["baseline's peak, Nm", "reduction, %", "at\u00a0work, %"];
if (!numbers(data.baseline).length) for (const title of COMPARED) COLUMNS.splice(COLUMNS.findIndex((column) => column.title === title), 1);
// Plans without a page of their own are named by where they are.
if (data.plan.some((plan, k) => plan !== null && !linkOf(k))) COLUMNS.push({ title: "plan directory", of: (k) => data.plan[k] });
const PAGE = 200;
let order = { column: 1, sign: 1 };
let limit = PAGE;

/* A colour between two for a share from 0 to 1. */
function shade(share) {
  const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
  const [from, to] = dark ? [[240, 200, 110], [70, 175, 220]] : [[214, 178, 94], [16, 104, 138]];
  return `rgb(${from.map((value, k) => Math.round(value + share * (to[k] - value))).join(",")})`;
}

function colouring() {
  const kind = element("colour").value;
  const others = data.planned.includes(null) ? [[colour("--bad"), "not planned"]] : [];
  if (kind === "ended") {
    const good = data.planned.some((value) => value !== null) ? [[colour("--good"), "planned"]] : [];
    return { of: (k) => colour(planned(k) ? "--good" : "--bad"), legend: [...good, ...others] };
  }
  const clearance = () => data.clearance.map((value) => (value === null ? null : 1e3 * value));
  const values = kind === "gain" ? gain : kind === "work" ? workGain : clearance();
  const known = numbers(values);
  const low = Math.min(...ends(known)), high = Math.max(...ends(known));
  const unit = kind === "clearance" ? "mm" : "%";
  const same = low.toFixed(1) === high.toFixed(1);
  const legend = known.length ? [...(same ? [] : [[shade(0), `${low.toFixed(1)} ${unit}`]]), [shade(1), `${high.toFixed(1)} ${unit}`]] : [];
  const none = values.some((value, k) => value === null && planned(k)) ? [[colour("--faint"), kind === "clearance" ? "nothing to hit" : "no reduction stated"]] : [];
  return { of: (k) => (!planned(k) ? colour("--bad") : values[k] === null ? colour("--faint") : shade(same ? 1 : (values[k] - low) / (high - low))),
    legend: [...legend, ...none, ...others] };
}

/* The least and the greatest of many numbers. */
function ends(values) {
  return values.length ? values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]) : [0, 1];
}

function canvas(id) {
  const target = element(id), ratio = window.devicePixelRatio || 1;
  const width = target.clientWidth, height = target.clientHeight;
  target.width = width * ratio;
  target.height = height * ratio;
  const draw = target.getContext("2d");
  draw.scale(ratio, ratio);
  draw.font = "12px system-ui, sans-serif";
  draw.fillStyle = colour("--faint");
  draw.strokeStyle = colour("--line");
  return { draw, width, height };
}

/* Round numbers from `low` to `high`: as few as possible, but `least`. */
function ticks(low, high, least) {
  const power = 10 ** Math.ceil(Math.log10(high - low || 1));
  for (const step of [1, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01].map((share) => share * power)) {
    const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
    if (last - first + 1 >= least) return Array.from({ length: last - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(12)));
  }
  return [low, high];
}

/* Round numbers around what is drawn; from 0 where the least is not far from it. */
function around(low, high) {
  if (high <= 0) return [0, 1];
  const inside = low < 0.5 * high || low === high ? ticks(0, high, 4) : ticks(low, high, 3);
  const step = inside[1] - inside[0];
  if (inside[0] > low) inside.unshift(inside[0] - step);
  if (inside.at(-1) < high) inside.push(inside.at(-1) + step);
  return inside.map((tick) => Number(tick.toPrecision(12)));
}

/* What of the places is shown: all of them, or what was asked for. */
function shownPlaces() {
  let [low, high] = ends(numbers(place));
  if (low === high) [low, high] = [low - 1, high + 1];
  const [from, to] = ["from", "to"].map((id) => element(id).value);
  const asked = [from === "" ? low : Number(from), to === "" ? high : Number(to)];
  return asked[0] < asked[1] ? asked : [low, high];
}

let points = [];
function drawMap() {
  const { of, legend } = colouring();
  element("key").replaceChildren(...legend.flatMap(([paint, text]) => {
    const swatch = document.createElement("i");
    swatch.style.background = paint;
    return [swatch, text];
  }));
  const heights = numbers(data.planned);
  element("map").className = heights.length ? "" : "empty";
  const { draw, width, height } = canvas("map");
  // Below the axis, a line of those without a plan.
  const box = { left: 52, right: width - 12, top: 26, bottom: height - (heights.length < count ? 54 : 36) };
  const [left, right] = shownPlaces();
  const x = (value) => box.left + ((value - left) / (right - left)) * (box.right - box.left);
  const levels = heights.length ? around(...ends(heights)) : [];
  const [low, high] = [levels[0], levels.at(-1)];
  const y = (value) => box.bottom - ((value - low) / (high - low)) * (box.bottom - box.top);
  for (const level of levels) {
    draw.beginPath();
    draw.moveTo(box.left, y(level));
    draw.lineTo(box.right, y(level));
    draw.stroke();
    draw.textAlign = "right";
    draw.fillText(`${level}`, box.left - 6, y(level) + 4);
  }
  draw.textAlign = "center";
  const across = ticks(left, right, Math.max(width / 160, 3)).filter((tick) => anyPlace || (Number.isInteger(tick) && tick >= 1 && tick <= count));
  for (const tick of across) draw.fillText(`${tick}`, x(tick), height - 20);
  draw.fillText(anyPlace ? "along the rail, m" : "job", (box.left + box.right) / 2, height - 3);
  draw.textAlign = "left";
  if (levels.length) draw.fillText("Peak torque, Nm", 4, 12);
  points = [];
  for (let k = 0; k < count; k += 1) {
    if (place[k] === null || place[k] < left || place[k] > right) continue;
    const at = [x(place[k]), planned(k) ? y(data.planned[k]) : height - 42];
    points.push([...at, k]);
    draw.fillStyle = of(k);
    draw.beginPath();
    if (planned(k)) draw.arc(...at, 4, 0, 2 * Math.PI);
    else draw.rect(at[0] - 4, at[1] - 4, 8, 8);
    draw.fill();
  }
}

function drawHistogram(id, values) {
  const { draw, width, height } = canvas(id);
  const known = numbers(values);
  if (!known.length) {
    draw.fillText("no figures", 8, 20);
    return;
  }
  let [low, high] = ends(known);
  if (low === high) [low, high] = [low - 0.5, high + 0.5];
  const bins = Array(24).fill(0);
  for (const value of known) bins[Math.min(Math.floor((24 * (value - low)) / (high - low)), 23)] += 1;
  const most = Math.max(...bins), bottom = height - 20, wide = width / 24;
  draw.fillStyle = colour("--baseline");
  bins.forEach((number, k) => draw.fillRect(k * wide + 1, bottom - ((bottom - 14) * number) / most, wide - 2, ((bottom - 14) * number) / most));
  draw.fillStyle = colour("--faint");
  draw.fillText(low.toFixed(1), 0, height - 4);
  draw.textAlign = "right";
  draw.fillText(high.toFixed(1), width, height - 4);
  draw.fillText(`highest bar: ${most.toLocaleString("en")} ${most === 1 ? "job" : "jobs"}`, width, 11);
}

function chosen() {
  const words = element("find").value.toLowerCase(), end = element("end").value;
  const found = [];
  for (let k = 0; k < count; k += 1) {
    if (end && data.ended[k] !== end) continue;
    if (words && !`${data.name[k]} ${data.reason[k]}`.toLowerCase().includes(words)) continue;
    found.push(k);
  }
  const { of } = COLUMNS[order.column];
  return found.sort((a, b) => {
    const [first, second] = [of(a), of(b)];
    if (first === second) return a - b;
    if (first === null) return 1;
    if (second === null) return -1;
    return order.sign * (first < second ? -1 : 1);
  });
}

function drawTable() {
  const found = chosen();
  element("shown").textContent = `${found.length.toLocaleString("en")} of ${count.toLocaleString("en")}`;
  element("rows").replaceChildren(...found.slice(0, limit).flatMap((k) => {
    const row = document.createElement("tr");
    COLUMNS.forEach((column, number) => {
      const cell = document.createElement("td"), value = column.of(k);
      if (number === 0 && linkOf(k)) {
        const link = document.createElement("a");
        link.href = linkOf(k);
        link.textContent = value;
        cell.append(link);
      } else cell.textContent = column.digits === undefined ? value : digits(value, column.digits);
      if (column.digits !== undefined) cell.className = "number";
      if (column.title === "ended" && value !== "planned") cell.className = "bad";
      row.append(cell);
    });
    return data.reason[k] ? [row, reasonOf(k)] : [row];
  }));
  element("more").hidden = found.length <= limit;
}

/* Why a job was not planned, below its row, so that it is read whole on a narrow page. */
function reasonOf(k) {
  const row = document.createElement("tr"), cell = document.createElement("td"), words = document.createElement("p");
  row.className = "why";
  cell.colSpan = COLUMNS.length;
  words.textContent = data.reason[k];
  cell.append(words);
  row.append(cell);
  return row;
}

function drawHeads() {
  element("heads").replaceChildren(...COLUMNS.map((column, number) => {
    const head = document.createElement("th"), button = document.createElement("button");
    button.textContent = column.title + (number === order.column ? (order.sign > 0 ? " ▲" : " ▼") : "");
    button.addEventListener("click", () => {
      order = { column: number, sign: number === order.column ? -order.sign : 1 };
      drawHeads();
      drawTable();
    });
    head.append(button);
    head.setAttribute("aria-sort", number !== order.column ? "none" : order.sign > 0 ? "ascending" : "descending");
    if (column.digits !== undefined) head.className = "number";
    return head;
  }));
}

const comparedWith = (k) => (data.baseline[k] === null ? "" : `, baseline ${digits(data.baseline[k], 1)} Nm${data.faults[k] ? `, which ${data.faults[k]}` : ""}`);

function nearest(event) {
  const box = element("map").getBoundingClientRect();
  const [x, y] = [event.clientX - box.left, event.clientY - box.top];
  let best = null, least = 144;
  for (const [px, py, k] of points) {
    const distance = (px - x) ** 2 + (py - y) ** 2;
    if (distance < least) [best, least] = [[px, py, k], distance];
  }
  return best;
}

element("map").addEventListener("pointermove", (event) => {
  const found = nearest(event), tip = element("tip");
  tip.hidden = found === null;
  element("map").style.cursor = found && linkOf(found[2]) ? "pointer" : "default";
  if (!found) return;
  const [x, y, k] = found;
  const figures = !planned(k) ? `${data.ended[k]}: ${data.reason[k]}`
    : `${digits(data.planned[k], 1)} Nm${comparedWith(k)}`;
  tip.textContent = `${data.name[k]}\n${figures}`;
  tip.style.left = `${Math.min(x + 10, element("map").clientWidth - 200)}px`;
  tip.style.top = `${y + 10}px`;
});
element("map").addEventListener("pointerleave", () => { element("tip").hidden = true; });
element("map").addEventListener("click", (event) => {
  const found = nearest(event);
  if (found && linkOf(found[2])) window.location.href = linkOf(found[2]);
});

function drawAll() {
  drawMap();
  drawHistogram("peaks", data.planned);
  const work = element("colour").value === "work";
  element("below").textContent = work ? "Reduction at work, %" : "Reduction of the peak torque, %";
  drawHistogram("gains", work ? workGain : gain);
}

for (const end of [...new Set(data.ended)].sort()) element("end").append(new Option(end, end));
/* What the jobs gain whose baselines keep the limits; nothing where there are none. */
function medians() {
  const whole = numbers(gain).length ? `the peak of the median job is ${middle(gain)} its baseline's` : "";
  if (!numbers(workGain).length) return whole && `; ${whole}`;
  return whole ? `; ${whole}, at work alone ${middle(workGain)}` : `; at work alone the peak of the median job is ${middle(workGain)} its baseline's`;
}

/* In words, how far the middle one of jobs is below its baseline. */
function middle(values) {
  const sorted = numbers(values).sort((a, b) => a - b);
  const value = sorted[Math.floor((sorted.length - 1) / 2)];
  return value >= 0 ? `${value.toFixed(1)} % below` : `${(-value).toFixed(1)} % above`;
}

const broken = data.faults.filter((fault, k) => fault && planned(k)).length;
if (broken) element("none").textContent = ` For ${broken.toLocaleString("en")} of ${count.toLocaleString("en")} jobs none is stated over the whole job, as the baseline breaks a limit.`;
if (numbers(data.planned).length) {
  const worst = data.planned.reduce((best, value, k) => (value !== null && (best < 0 || value > data.planned[best]) ? k : best), -1);
  element("summary").textContent =
    `The base must bear at most ${data.planned[worst].toFixed(1)} Nm (${data.name[worst]})${medians()}.`;
  // The posture in which the arms begin may decide over whole jobs: then the work tells them apart.
  const spread = (values) => { const [low, high] = ends(numbers(values)); return high - low; };
  if (!numbers(gain).length) element("colour").value = numbers(workGain).length ? "work" : "clearance";
  else if (spread(gain) < 0.1 && spread(workGain) >= 0.1) element("colour").value = "work";
}
for (const id of ["find", "end"]) element(id).addEventListener("input", () => { limit = PAGE; drawTable(); });
element("colour").addEventListener("input", drawAll);
element("more").addEventListener("click", () => { limit += PAGE; drawTable(); });
window.addEventListener("resize", drawAll);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
for (const id of ["from", "to"]) element(id).addEventListener("input", drawMap);
[element("from").placeholder, element("to").placeholder] = ends(numbers(place)).map((end) => `${Number(end.toFixed(2))}`);
element("unit").textContent = anyPlace ? "m" : "";
const unplaced = place.filter((each) => each === null).length;
element("unplaced").textContent = unplaced ? `Not on the map, without a place (at_m): ${unplaced.toLocaleString("en")} of ${count.toLocaleString("en")} jobs.` : "";
element("unplaced").hidden = !unplaced;
element("histograms").hidden = !numbers(data.planned).length;
element("place").textContent = anyPlace ? "Along the rail" : "Peak torque of each job";
drawHeads();
drawTable();
drawAll();
