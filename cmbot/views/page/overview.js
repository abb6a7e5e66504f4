"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const count = data.name.length;
const below = (planned, baseline) => planned.map((value, k) => (value === null || !baseline[k] ? null : 100 * (1 - value / baseline[k])));
const gain = below(data.planned, data.baseline), workGain = below(data.workPlanned, data.workBaseline);
const anyPlace = data.at.some((at) => at !== null);
const place = data.at.map((at, k) => (anyPlace ? at : k + 1));
const element = (id) => document.getElementById(id);
const numbers = (values) => values.filter((value) => value !== null);
const digits = (value, number) => (value === null ? "" : value.toFixed(number));
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const COLUMNS = [
  { title: "job", of: (k) => data.name[k] },
  { title: anyPlace ? "at, m" : "number", of: (k) => place[k], digits: anyPlace ? 2 : 0 },
  { title: "ended", of: (k) => data.ended[k] },
  { title: "baseline, Nm", of: (k) => data.baseline[k], digits: 1 },
  { title: "planned, Nm", of: (k) => data.planned[k], digits: 1 },
  { title: "below, %", of: (k) => gain[k], digits: 1 },
  { title: "work below, %", of: (k) => workGain[k], digits: 1 },
  { title: "clearance, mm", of: (k) => (data.clearance[k] === null ? null : 1e3 * data.clearance[k]), digits: 0 },
  { title: "motion, s", of: (k) => data.duration[k], digits: 1 },
  { title: "planned in, s", of: (k) => data.seconds[k], digits: 1 },
];
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
  if (kind === "ended") {
    return { of: (k) => (data.ended[k] === "planned" ? colour("--good") : colour("--bad")),
      legend: [[colour("--good"), "planned"], [colour("--bad"), "not planned"]] };
  }
  const clearance = () => data.clearance.map((value) => (value === null ? null : 1e3 * value));
  const values = kind === "gain" ? gain : kind === "work" ? workGain : clearance();
  const known = numbers(values);
  const low = Math.min(...ends(known)), high = Math.max(...ends(known));
  const unit = kind === "clearance" ? "mm" : "%";
  const same = low.toFixed(1) === high.toFixed(1);
  const legend = known.length ? [...(same ? [] : [[shade(0), `${low.toFixed(1)} ${unit}`]]), [shade(1), `${high.toFixed(1)} ${unit}`]] : [];
  return { of: (k) => (values[k] === null ? colour("--bad") : shade(same ? 1 : (values[k] - low) / (high - low))),
    legend: [...legend, [colour("--bad"), "not planned"]] };
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

function ticks(low, high, number) {
  const raw = (high - low) / number || 1, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= raw);
  const first = Math.ceil(low / step), last = Math.floor(high / step + 1e-9);
  return Array.from({ length: Math.max(last - first + 1, 0) }, (_, k) => Number(((first + k) * step).toPrecision(12)));
}

let points = [];
function drawMap() {
  const { draw, width, height } = canvas("map");
  const { of, legend } = colouring();
  element("key").replaceChildren(...legend.flatMap(([paint, text]) => {
    const swatch = document.createElement("i");
    swatch.style.background = paint;
    return [swatch, text];
  }));
  const box = { left: 52, right: width - 12, top: 10, bottom: height - 34 };
  let [left, right] = ends(numbers(place)), [, top] = ends(numbers(data.planned));
  if (left === right) [left, right] = [left - 1, right + 1];
  const x = (value) => box.left + ((value - left) / (right - left)) * (box.right - box.left);
  const y = (value) => box.bottom - (value / (1.05 * top || 1)) * (box.bottom - box.top);
  for (const tick of ticks(0, top, 5)) {
    draw.beginPath();
    draw.moveTo(box.left, y(tick));
    draw.lineTo(box.right, y(tick));
    draw.stroke();
    draw.textAlign = "right";
    draw.fillText(`${tick}`, box.left - 6, y(tick) + 4);
  }
  draw.textAlign = "center";
  const across = ticks(left, right, Math.max(width / 110, 2)).filter((tick) => anyPlace || Number.isInteger(tick));
  for (const tick of across) draw.fillText(`${tick}`, x(tick), box.bottom + 16);
  draw.fillText(anyPlace ? "along the rail, m" : "job", (box.left + box.right) / 2, height - 3);
  draw.textAlign = "left";
  draw.fillText("Nm", 4, 12);
  points = [];
  for (let k = 0; k < count; k += 1) {
    if (place[k] === null) continue;
    const there = data.planned[k] !== null;
    const at = [x(place[k]), there ? y(data.planned[k]) : box.bottom];
    points.push([...at, k]);
    draw.fillStyle = of(k);
    draw.beginPath();
    if (there) draw.arc(...at, 4, 0, 2 * Math.PI);
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
  draw.fillText(`at most ${most.toLocaleString("en")} in a bar`, width, 11);
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
      if (number === 0 && data.link[k]) {
        const link = document.createElement("a");
        link.href = data.link[k];
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
  element("map").style.cursor = found && data.link[found[2]] ? "pointer" : "default";
  if (!found) return;
  const [x, y, k] = found;
  const figures = data.planned[k] === null ? `${data.ended[k]}: ${data.reason[k]}`
    : `${digits(data.planned[k], 1)} Nm, baseline ${digits(data.baseline[k], 1)} Nm`;
  tip.textContent = `${data.name[k]}\n${figures}`;
  tip.style.left = `${Math.min(x + 10, element("map").clientWidth - 200)}px`;
  tip.style.top = `${y + 10}px`;
});
element("map").addEventListener("pointerleave", () => { element("tip").hidden = true; });
element("map").addEventListener("click", (event) => {
  const found = nearest(event);
  if (found && data.link[found[2]]) window.location.href = data.link[found[2]];
});

function drawAll() {
  drawMap();
  drawHistogram("peaks", data.planned);
  const work = element("colour").value === "work";
  element("below").textContent = `${work ? "The work alone below" : "Below"} the baseline, %`;
  drawHistogram("gains", work ? workGain : gain);
}

for (const end of [...new Set(data.ended)].sort()) element("end").append(new Option(end, end));
/* In words, how far the middle one of jobs is below its baseline. */
function middle(values) {
  const sorted = numbers(values).sort((a, b) => a - b);
  const value = sorted[Math.floor((sorted.length - 1) / 2)];
  return value >= 0 ? `${value.toFixed(1)} % below` : `${(-value).toFixed(1)} % above`;
}

if (numbers(gain).length) {
  const worst = data.planned.reduce((best, value, k) => (value !== null && (best < 0 || value > data.planned[best]) ? k : best), -1);
  element("summary").textContent =
    `The base must bear at most ${data.planned[worst].toFixed(1)} Nm (${data.name[worst]}); the peak of the median job is ${middle(gain)} its baseline's, at work alone ${middle(workGain)}.`;
  // The posture in which the arms begin may decide over whole jobs: then the work tells them apart.
  const spread = (values) => { const [low, high] = ends(numbers(values)); return high - low; };
  if (spread(gain) < 0.1 && spread(workGain) >= 0.1) element("colour").value = "work";
}
for (const id of ["find", "end"]) element(id).addEventListener("input", () => { limit = PAGE; drawTable(); });
element("colour").addEventListener("input", drawAll);
element("more").addEventListener("click", () => { limit += PAGE; drawTable(); });
window.addEventListener("resize", drawAll);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
element("place").textContent = anyPlace ? "Along the rail" : "Peak torque of each job";
drawHeads();
drawTable();
drawAll();
