// The norm of the torque over time, above the slider and in step with its thumb.
const INSET = 8;  // half a slider's thumb, px
const TITLE = 12;  // where words stand, px

class TorquePlot {
  constructor(canvas, data, phases, peak) {
    Object.assign(this, { canvas, data, phases, peak });
  }

  // The time below a pointer.
  timeAt(clientX) {
    const { start, end } = this.data, box = this.canvas.getBoundingClientRect();
    return start + ((clientX - box.left - INSET) / (box.width - 2 * INSET)) * (end - start);
  }

  x(time) {
    const { start, end } = this.data;
    return INSET + ((time - start) / (end - start)) * (this.width - 2 * INSET);
  }

  y(torque) {
    return this.height - 3 - (torque / this.peak) * (this.height - 18);
  }

  draw(now) {
    const { canvas } = this, ratio = window.devicePixelRatio || 1;
    this.width = canvas.clientWidth;
    this.height = canvas.clientHeight;
    canvas.width = Math.round(this.width * ratio);
    canvas.height = Math.round(this.height * ratio);
    this.pen = canvas.getContext("2d");
    this.pen.scale(ratio, ratio);
    this.pen.font = "11px system-ui, sans-serif";
    const style = getComputedStyle(document.documentElement);
    this.colour = (name) => style.getPropertyValue(`--${name}`);
    // Words stand above the curves.
    const title = `Torque on the ${this.data.base}, 0 to ${newtonMetres(this.peak)}`, long = this.pen.measureText(title).width;
    const left = Math.max(Math.min(this.x(this.data.workStart) + 6, this.width - INSET - long), INSET);
    for (const phase of this.phases) if (phase.free) this.shade(phase, left, left + long);
    for (const time of this.data.legTimes) this.upright(time, this.colour("line"), 1);
    this.line([[this.x(this.data.start), this.y(0)], [this.x(this.data.end), this.y(0)]], this.colour("line"), 1);
    for (const phase of this.phases) this.drawPhase(phase);
    this.drawLowerBound();
    this.text(title, left, TITLE);
    this.upright(now, this.colour("ink"), 1.5);
  }

  // A free move, with its label, or its name where there is less room; none where the title is.
  shade({ start, end, label, free }, titleBegin, titleEnd) {
    this.pen.fillStyle = this.colour("free-move");
    this.pen.fillRect(this.x(start), 0, this.x(end) - this.x(start), this.height);
    const room = this.x(end) - this.x(start) - 8;
    const from = this.x(start) + 4, beside = (wide) => from + wide < titleBegin || from > titleEnd;
    const shown = [label, free].find((text) => {
      const { width } = this.pen.measureText(text);
      return width <= room && beside(width);
    });
    if (shown) this.text(shown, from, TITLE);
  }

  drawPhase(phase) {
    for (const name of [...MOTIONS].reverse()) {
      const { norms, still } = phase.motions[name], wide = name === MOTIONS[0] ? 2 : 1.5;
      if (still) continue;  // it has no approach or no return
      const point = (norm, k) => [this.x(phase.timeOf(k / (norms.length - 1))), this.y(norm)];
      this.line(Array.from(norms, point), this.colour(name), wide);
    }
  }

  // Lower bound of the peak torque during the work.
  drawLowerBound() {
    const { floor, floorName, workStart, workEnd } = this.data;
    if (floor === null) return;
    this.pen.setLineDash([5, 4]);
    this.line([[this.x(workStart), this.y(floor)], [this.x(workEnd), this.y(floor)]], this.colour("ink"), 1);
    this.pen.setLineDash([]);
    if (this.height < 50) return;  // no room for its label
    const label = `${floorName} ${newtonMetres(floor)}`, size = `${this.width} ${this.height}`;
    // Its place changes with the plot's size only.
    if (this.named?.size !== size) this.named = { size, place: this.floorPlace(this.pen.measureText(label).width) };
    this.text(label, ...this.named.place);
  }

  // Where a name of the lower bound, so wide, hides least of the curves.
  floorPlace(wide) {
    const { floor, workStart, workEnd } = this.data, room = this.x(workEnd) - this.x(workStart) - 8;
    const shares = wide < room ? [1, 0.75, 0.5, 0.25, 0] : [1];
    const places = [12, -4, 24, 36].flatMap((below) => shares.map((share) => [this.x(workEnd) - 4 - wide - (1 - share) * (room - wide), this.y(floor) + below]));
    const inside = places.filter(([, y]) => y > TITLE + 12 && y < this.height - 2);
    return leastHidden(inside, ([x, y]) => this.crossed(x, y, wide)) ?? places[0];
  }

  // How often curves cross words at a place, every few pixels.
  crossed(x, y, wide) {
    let count = 0;
    for (const { start, end, motions } of this.phases) {
      for (const { norms } of Object.values(motions)) {
        for (let at = Math.max(x, this.x(start)); at < Math.min(x + wide, this.x(end)); at += 4) {
          const share = (at - this.x(start)) / (this.x(end) - this.x(start));
          const height = this.y(norms[Math.round(share * (norms.length - 1))]);
          if (height > y - 11 && height < y + 3) count += 1;
        }
      }
    }
    return count;
  }

  upright(time, colour, wide) {
    this.line([[this.x(time), 0], [this.x(time), this.height]], colour, wide);
  }

  line(points, colour, wide) {
    const { pen } = this;
    pen.beginPath();
    for (const [x, y] of points) pen.lineTo(x, y);
    pen.strokeStyle = colour;
    pen.lineWidth = wide;
    pen.stroke();
  }

  text(words, x, y) {
    const { pen } = this;
    pen.strokeStyle = this.colour("halo");  // readable across a curve
    pen.lineWidth = 3;
    pen.strokeText(words, x, y);
    pen.fillStyle = this.colour("faint");
    pen.fillText(words, x, y);
  }
}
