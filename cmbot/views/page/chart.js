// A plot as SVG: curves over the page's whole time, shaded bounds, and a cursor at the present time.
const SVG = "http://www.w3.org/2000/svg";

function make(name, attributes = {}, parent = null, text = null) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== null) element.textContent = text;
  parent?.append(element);
  return element;
}

// Labelled values of an axis, 1, 2 or 5 times a power of ten apart.
function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const values = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k += 1) values.push(k * step);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return values.map((value) => [value, (value + 0).toFixed(digits).replace(/^-(0(\.0+)?)$/, "$1")]);
}

const shortened = (value) => (Math.abs(value) >= 100 ? value.toFixed(0) : Number(value.toPrecision(3)).toString());

class Curve {
  constructor(source) {
    this.motion = source.motion;
    this.thin = source.thin;
    this.t = floats(source.t);
    this.y = floats(source.y);
    this.starts = new Set(source.starts);
  }

  // Value at a time, null before and after the curve, and where it is broken.
  at(time) {
    const { t, y } = this, last = t.length - 1;
    if (time < t[0] - 1e-4 || time > t[last] + 1e-4) return null;
    let low = 0, high = last;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (t[middle] <= time) low = middle;
      else high = middle;
    }
    if (this.starts.has(high) && time > t[low] + 1e-4 && time < t[high] - 1e-4) return null;
    const share = Math.min(Math.max((time - t[low]) / (t[high] - t[low]), 0), 1);
    return y[low] + share * (y[high] - y[low]);
  }

  get extent() {
    return this.y.reduce(([low, high], y) => [Math.min(low, y), Math.max(high, y)], [Infinity, -Infinity]);
  }

  // Largest share of the bounds, 1 at a bound.
  use([low, high]) {
    const middle = (low + high) / 2, half = (high - low) / 2;
    return Math.max(...this.extent.map((y) => Math.abs(y - middle) / half));
  }
}

let clips = 0;
const nameOf = (curve) => (curve.thin ? `${motionName(curve.motion)}, static part` : motionName(curve.motion));

// One for all plots.
function tooltip() {
  let tip = document.getElementById("tip");
  if (!tip) {
    tip = document.createElement("div");
    tip.id = "tip";
    document.body.append(tip);
  }
  return tip;
}

class Chart {
  // `timeline`: start, end, legTimes and moves of the page. `small`: without caption, ticks and marks.
  constructor(spec, timeline, onSeek, { small = false, name = spec.title, onOpen = null } = {}) {
    Object.assign(this, { spec, timeline, small, name, zoomed: false, time: timeline.start });
    this.curves = spec.curves.map((source) => new Curve(source));
    this.figure = document.createElement("figure");
    this.figure.className = small ? "chart small" : "chart";
    if (!small) this.addCaption();
    this.svg = make("svg", { role: "img" });
    this.figure.append(this.svg);
    this.connect(onSeek, onOpen);
  }

  // A click or a drag sets the time; a click in a small plot shows its joint large.
  connect(onSeek, onOpen) {
    const { svg } = this;
    let from = null;
    svg.addEventListener("pointerdown", (event) => {
      svg.setPointerCapture(event.pointerId);
      from = event.clientX;
      if (!onOpen) onSeek(this.timeAt(event.clientX));
    });
    svg.addEventListener("pointermove", (event) => {
      if (event.buttons & 1 && (!onOpen || Math.abs(event.clientX - from) > 4)) onSeek(this.timeAt(event.clientX));
      this.hover(event);
    });
    svg.addEventListener("pointerup", (event) => {
      if (onOpen && from !== null && Math.abs(event.clientX - from) <= 4) onOpen();
      from = null;
    });
    for (const end of ["pointerleave", "pointercancel"]) svg.addEventListener(end, () => this.hover(null));
  }

  // Every curve's value at the pointer, beside it.
  hover(event) {
    const tip = tooltip();
    tip.hidden = event === null;
    this.pointed?.setAttribute("visibility", event === null ? "hidden" : "visible");
    if (event === null) return;
    const { start, end } = this.timeline, time = Math.min(Math.max(this.timeAt(event.clientX), start), end);
    const lines = [[`t = ${seconds(time)} s`, ""]], { digits, unit } = this.spec;
    for (const curve of [...this.curves].reverse()) {
      const value = curve.at(time);
      if (value !== null) lines.push([`${nameOf(curve)} ${value.toFixed(digits)} ${unit}`, curve.motion]);
    }
    tip.replaceChildren(...lines.map(([text, motion]) => {
      const line = document.createElement("div");
      line.textContent = text;
      line.className = motion;
      return line;
    }));
    for (const name of ["x1", "x2"]) this.pointed?.setAttribute(name, this.x(time).toFixed(1));
    const left = Math.min(event.clientX + 14, window.innerWidth - tip.offsetWidth - 6);
    const above = event.clientY - tip.offsetHeight - 12;
    tip.style.transform = `translate(${Math.max(left, 4)}px, ${above > 4 ? above : event.clientY + 18}px)`;
  }

  addCaption() {
    const caption = document.createElement("figcaption"), title = document.createElement("b");
    title.textContent = `${this.spec.title}, ${this.spec.unit}`;
    this.values = document.createElement("span");
    caption.append(title, this.values);
    this.figure.append(caption);
    if (!this.spec.note) return;
    const note = document.createElement("p");
    note.textContent = this.spec.note;
    this.figure.append(note);
  }

  x(time) {
    const { start, end } = this.timeline, { left, right } = this.inset;
    return left + ((time - start) / (end - start)) * (this.width - left - right);
  }

  y(value) {
    const { top, bottom } = this.inset, [low, high] = this.axis;
    return this.height - bottom - ((value - low) / (high - low)) * (this.height - top - bottom);
  }

  timeAt(clientX) {
    const box = this.svg.getBoundingClientRect();
    return this.timeOf(((clientX - box.left) / box.width) * this.width);
  }

  timeOf(x) {
    const { start, end } = this.timeline, { left, right } = this.inset;
    return start + ((x - left) / (this.width - left - right)) * (end - start);
  }

  // Range of the axis: the bounds, or the curves alone.
  get range() {
    if (!this.zoomed) return this.spec.axis;
    // As on the page, what goes far beyond the planned motion is clipped.
    const planned = this.curves.filter((curve) => curve.motion !== "baseline").map((curve) => curve.extent);
    const extents = this.curves.map((curve) => curve.extent);
    const ends = (all) => [Math.min(...all.map((e) => e[0])), Math.max(...all.map((e) => e[1]))];
    const [least, most] = ends(planned.length ? planned : extents), span = most - least || 1;
    const low = Math.max(ends(extents)[0], least - span), high = Math.min(ends(extents)[1], most + span);
    const room = 0.06 * (high - low) || 1;
    return [low - room, high + room];
  }

  draw(width = this.figure.clientWidth) {
    const { svg, small } = this;
    this.width = Math.max(width, 60);
    this.height = small ? 80 : 140;
    this.inset = small ? { left: 2, right: 2, top: 14, bottom: 12 } : { left: 46, right: 8, top: 6, bottom: 24 };
    const [low, high] = this.range;
    this.axis = low < high ? [low, high] : [low - 1, high + 1];
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${this.width} ${this.height}`);
    svg.setAttribute("aria-label", this.describe());
    const { left, right, top, bottom } = this.inset;
    const frame = { x: left, y: top, width: this.width - left - right, height: this.height - top - bottom };
    make("rect", { class: "frame", ...frame }, svg);
    const clip = `clip-${(clips += 1)}`;
    make("rect", frame, make("clipPath", { id: clip }, make("defs", {}, svg)));
    const inside = make("g", { "clip-path": `url(#${clip})` }, svg);
    this.drawGround(inside, svg);
    for (const curve of this.curves) this.drawCurve(curve, inside);
    this.drawMarks(inside, svg);
    this.pointed = make("line", { class: "pointed", y1: top, y2: this.height - bottom, visibility: "hidden" }, svg);
    this.cursor = make("line", { class: "cursor", y1: top, y2: this.height - bottom }, svg);
    this.dots = this.curves.filter((c) => !c.thin).map((c) => [c, make("circle", { class: `dot ${c.motion}`, r: small ? 2.2 : 3.5 }, inside)]);
    if (small) this.drawCorners(svg);
    this.show(this.time);
  }

  drawGround(inside, svg) {
    const { start, legTimes, workStart, workEnd, end } = this.timeline, [low, high] = this.axis;
    const across = { x: this.x(start), width: this.x(end) - this.x(start) };
    const band = (name, from, to) => make("rect", { class: name, ...across, y: this.y(to), height: Math.max(this.y(from) - this.y(to), 0) }, inside);
    const free = [["approach", start, workStart], ...this.timeline.moves, [this.timeline.return ? "return" : "after the stop", workEnd, end]].filter(([, from, to]) => from < to);
    for (const [, from, to] of free) make("rect", { class: "free-move", x: this.x(from), y: 0, width: this.x(to) - this.x(from), height: this.height }, inside);
    const [lower, upper] = this.spec.bounds;
    if (lower !== null && lower > low) band("beyond", low, Math.min(lower, high));
    if (upper !== null && upper < high) band("beyond", Math.max(upper, low), high);
    for (const time of legTimes) make("line", { class: "leg", x1: this.x(time), x2: this.x(time), y1: 0, y2: this.height }, inside);
    if (this.small) return;
    for (const [value, text] of ticks(low, high, 4)) {
      make("line", { class: "grid", x1: across.x, x2: across.x + across.width, y1: this.y(value), y2: this.y(value) }, inside);
      make("text", { class: "tick", x: this.inset.left - 6, y: this.y(value) + 3.5, "text-anchor": "end" }, svg, text);
    }
    for (const [value, text] of ticks(start, end, 8)) {
      const x = this.x(value), anchor = x > this.width - 24 ? "end" : "middle";
      make("text", { class: "tick", x: anchor === "end" ? this.width - 2 : x, y: this.height - 6, "text-anchor": anchor }, svg, `${text} s`);
    }
    for (const move of free) this.nameFreeMove(svg, ...move);
  }

  // A free move's name and, below it, why it has no curve, where it has none.
  nameFreeMove(svg, name, from, to) {
    const x = this.x(from) + 5, y = this.height - this.inset.bottom - 5, room = this.x(to) - x;
    const why = this.curves.some((curve) => curve.at((from + to) / 2) !== null) ? "" : this.spec.free;
    const lines = [why, name].filter((words) => words && 6.2 * words.length < room);
    lines.forEach((words, k) => make("text", { class: "tick", x, y: y - 14 * k }, svg, words));
  }

  drawCurve(curve, inside) {
    let path = "";
    for (let k = 0; k < curve.t.length; k += 1) path += `${k && !curve.starts.has(k) ? "L" : "M"}${this.x(curve.t[k]).toFixed(1)} ${this.y(curve.y[k]).toFixed(1)}`;
    make("path", { class: `curve ${curve.motion}${curve.thin ? " thin" : ""}`, d: path }, inside);
  }

  drawMarks(inside, svg) {
    const { start, end } = this.timeline;
    for (const [value, name] of this.spec.marks) {
      const y = this.y(value);
      make("line", { class: "mark", x1: this.x(start), x2: this.x(end), y1: y, y2: y }, inside);
      const label = make("text", { class: "mark-name" }, svg, name);
      const [x, base] = this.freePlace(y, 6.2 * name.length);
      label.setAttribute("x", x);
      label.setAttribute("y", base);
    }
  }

  // Where a level's name hides least of the curves: above or below the level, somewhere along the axis.
  freePlace(y, long) {
    const { left, right, top, bottom } = this.inset, last = this.width - right - long - 5;
    const places = [y - 4, y + 13].flatMap((base) => [8, 7, 6, 5, 4, 3, 2, 1, 0].map((k) => [left + 5 + (k / 8) * (last - left - 5), base]));
    // A long straight line has few points: curves are followed from pixel to pixel, and lead from above to below.
    return leastHidden(places, ([x, base]) => {
      if (base - 11 < top || base > this.height - bottom) return Infinity;
      let count = 0;
      for (const curve of this.curves) {
        let last = null;
        for (let at = x - 3; at < x + long + 3; at += 2) {
          const value = curve.at(this.timeOf(at)), height = value === null ? null : this.y(value);
          const [high, low] = [Math.min(height, last ?? height), Math.max(height, last ?? height)];
          if (height !== null && low > base - 13 && high < base + 4) count += 1;
          last = height;
        }
      }
      return count;
    });
  }

  // Above and below the frame of a small plot: the ends of its axis, and each motion's share of the bounds.
  drawCorners(svg) {
    const { bounds, unit } = this.spec, [low, high] = this.axis, bound = bounds[1];
    const top = bound === null || this.zoomed ? high : bound;
    make("text", { class: "corner", x: 2, y: 10 }, svg, shortened(top));
    make("text", { class: "corner", x: 2, y: this.height - 2 }, svg, bound === null || this.zoomed ? shortened(low) : shortened(bounds[0]));
    if (bound === null || this.curves.length > 2) return;
    const uses = make("text", { class: "corner", x: this.width - 2, y: 10, "text-anchor": "end" }, svg);
    for (const [k, curve] of [...this.curves].reverse().entries()) {
      const share = curve.use(bounds);
      make("tspan", { class: `${curve.motion}${share > 1 ? " over" : ""}`, dx: k ? 5 : 0 }, uses, `${(100 * share).toFixed(0)} %`);
    }
    svg.append(make("title", {}, null, this.describe()));
  }

  describe() {
    const { unit, digits } = this.spec;
    const said = this.curves.filter((curve) => !curve.thin).map((curve) => {
      const [low, high] = curve.extent.map((value) => value.toFixed(digits));
      return `${motionName(curve.motion)} from ${low} to ${high} ${unit}`;
    });
    return `${this.name}: ${said.join(", ")}`;
  }

  show(time) {
    this.time = time;
    if (!this.cursor) return;
    const x = this.x(time).toFixed(2);
    this.cursor.setAttribute("x1", x);
    this.cursor.setAttribute("x2", x);
    for (const [curve, dot] of this.dots) {
      const value = curve.at(time);
      dot.setAttribute("visibility", value === null ? "hidden" : "visible");
      if (value === null) continue;
      dot.setAttribute("cx", x);
      dot.setAttribute("cy", this.y(value).toFixed(2));
    }
    if (this.values) this.showValues(time);
  }

  showValues(time) {
    const { unit, digits } = this.spec;
    this.values.replaceChildren(...this.dots.map(([curve]) => {
      const value = curve.at(time), part = document.createElement("span");
      part.className = curve.motion;
      part.textContent = `${motionName(curve.motion)} ${value === null ? "–" : `${value.toFixed(digits)} ${unit}`}`;
      return part;
    }).reverse());
  }
}
