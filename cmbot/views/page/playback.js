// Time: what the arms, the numbers and the plot show at a moment, and how the moment changes.
class Motion {
  constructor(data, source) {
    this.links = data.links.length;
    this.poses = floats(source.poses);
    this.torque = floats(source.torque);
    this.clearance = floats(source.clearance);
    this.peakTorque = source.peakTorque;
    this.minClearance = source.minClearance;
    this.norms = this.clearance.map((_, k) => Math.hypot(...this.torque.subarray(3 * k, 3 * k + 3)));
  }

  place(link, index, frame, share) {
    const p = [new THREE.Vector3(), new THREE.Vector3()], r = [new THREE.Quaternion(), new THREE.Quaternion()];
    for (const k of [0, 1]) {
      const start = 7 * ((frame + k) * this.links + index);
      p[k].fromArray(this.poses, start);
      r[k].fromArray(this.poses, start + 3);
    }
    link.position.lerpVectors(p[0], p[1], share);
    link.quaternion.copy(r[0].slerp(r[1], share));
  }

  torqueAt(frame, share) {
    const v = [0, 1].map((k) => new THREE.Vector3().fromArray(this.torque, 3 * (frame + k)));
    return v[0].lerp(v[1], share);
  }

  clearanceAt(frame, share) {
    return (1 - share) * this.clearance[frame] + share * this.clearance[frame + 1];
  }
}

class Replay {
  constructor(data) {
    this.data = data;
    this.stage = new Stage(data);
    this.motions = { planned: new Motion(data, data.planned), baseline: new Motion(data, data.baseline) };
    this.peak = Math.max(data.planned.peakTorque, data.baseline.peakTorque);
    this.ui = Object.fromEntries([...document.querySelectorAll("[id]")].map((element) => [element.id, element]));
    this.time = 0;
    this.playing = false;
    this.fillCard();
    this.connect();
    this.seek(0);
  }

  fillCard() {
    const { data, ui } = this;
    ui.subtitle.textContent = `${data.robot}, ${data.duration.toFixed(1)} s`;
    ui.scrub.max = data.duration;
    for (const [name, motion] of Object.entries(this.motions)) {
      ui[`${name}-peak`].textContent = newtonMetres(motion.peakTorque);
      show(ui[`${name}-closest`], motion.minClearance);
    }
  }

  connect() {
    const { ui, stage } = this;
    ui.play.addEventListener("click", () => (this.playing ? this.pause() : this.play()));
    ui.scrub.addEventListener("input", () => this.seek(Number(ui.scrub.value)));
    ui.reset.addEventListener("click", () => stage.resetView());
    ui.ghost.addEventListener("change", () => { stage.ghost.visible = ui.ghost.checked; stage.redraw(); });
    ui.arrow.addEventListener("change", () => { stage.arrow.group.visible = ui.arrow.checked; stage.redraw(); });
    const seekOnPlot = (event) => {
      if (!(event.buttons & 1)) return;
      const box = ui.plot.getBoundingClientRect();
      this.seek(((event.clientX - box.left - INSET) / (box.width - 2 * INSET)) * this.data.duration);
    };
    ui.plot.addEventListener("pointerdown", seekOnPlot);
    ui.plot.addEventListener("pointermove", seekOnPlot);
    window.addEventListener("keydown", (event) => this.onKey(event));
    window.addEventListener("resize", () => this.drawPlot());
    stage.afterRender(() => this.placeLabel());
  }

  onKey(event) {
    const { target, key } = event;
    if (event.ctrlKey || event.altKey || event.metaKey || target.tagName === "SELECT") return;
    const step = event.shiftKey ? 1 : 0.1;
    const onControl = target.tagName === "BUTTON" || target.type === "checkbox";
    if (key === " " && !onControl) this.playing ? this.pause() : this.play();
    else if (key === "ArrowLeft") this.seek(this.time - step);
    else if (key === "ArrowRight") this.seek(this.time + step);
    else if (key === "Home") this.seek(0);
    else if (key === "End") this.seek(this.data.duration);
    else return;
    event.preventDefault();
  }

  seek(time) {
    const { data, stage, ui } = this;
    if (!Number.isFinite(time)) return;
    this.time = Math.min(Math.max(time, 0), data.duration);
    const at = (this.time / data.duration) * (data.frames - 1);
    const frame = Math.min(Math.floor(at), data.frames - 2), share = at - frame;
    for (const [name, motion] of Object.entries(this.motions)) {
      stage.arms[name].forEach((link, index) => motion.place(link, index, frame, share));
      ui[`${name}-torque`].textContent = newtonMetres(motion.torqueAt(frame, share).length());
      show(ui[`${name}-clearance`], motion.clearanceAt(frame, share));
    }
    const torque = this.motions.planned.torqueAt(frame, share);
    stage.showTorque(torque, torque.length() / this.peak);
    ui["torque-label"].textContent = newtonMetres(torque.length());
    ui.scrub.value = this.time;
    ui.time.textContent = `${this.time.toFixed(2)} / ${data.duration.toFixed(2)} s`;
    this.drawPlot();
    stage.redraw();
  }

  play() {
    if (this.playing) return;
    if (this.time >= this.data.duration) this.seek(0);
    this.setPlaying(true);
    let last = performance.now();
    const advance = (now) => {
      if (!this.playing) return;
      // A tab that was in the background goes on where it was left.
      const passed = Math.min(Math.max(now - last, 0), 500) / 1000;
      last = now;
      this.seek(this.time + Number(this.ui.speed.value) * passed);
      if (this.time >= this.data.duration) this.pause();
      else requestAnimationFrame(advance);
    };
    requestAnimationFrame(advance);
  }

  pause() {
    this.setPlaying(false);
  }

  setPlaying(playing) {
    this.playing = playing;
    this.ui.play.classList.toggle("playing", playing);
    this.ui.play.setAttribute("aria-label", playing ? "Pause" : "Play");
  }

  placeLabel() {
    const { ui, stage } = this;
    const [x, y] = stage.onScreen(stage.arrow.tip);
    ui["torque-label"].style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, 8px)`;
    ui["torque-label"].hidden = !stage.arrow.group.visible;
  }

  // Norm of the torque over time, above the slider and in step with its thumb.
  drawPlot() {
    const canvas = this.ui.plot, ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const x = (share) => INSET + share * (width - 2 * INSET);
    const y = (torque) => height - 3 - (torque / this.peak) * (height - 16);
    const line = (points, colour, wide) => {
      pen.beginPath();
      for (const [px, py] of points) pen.lineTo(px, py);
      pen.strokeStyle = colour;
      pen.lineWidth = wide;
      pen.stroke();
    };
    for (const time of this.data.legTimes) {
      const at = x(time / this.data.duration);
      line([[at, 0], [at, height]], "#d5dce3", 1);
    }
    line([[x(0), y(0)], [x(1), y(0)]], "#b9c3cd", 1);
    for (const [name, colour, wide] of [["baseline", "#2f6fb7", 1.5], ["planned", "#e0560f", 2]]) {
      const { norms } = this.motions[name];
      line(Array.from(norms, (norm, k) => [x(k / (norms.length - 1)), y(norm)]), colour, wide);
    }
    const now = x(this.time / this.data.duration);
    line([[now, 0], [now, height]], "#1d2733", 1.5);
    pen.fillStyle = "#5d6b7a";
    pen.font = "11px system-ui, sans-serif";
    pen.fillText("Torque on the guardrail, 0 to " + newtonMetres(this.peak), INSET + 6, height - 8);
  }
}

const INSET = 8;  // half a slider's thumb, px
const newtonMetres = (value) => `${value.toFixed(1)} Nm`;

function show(cell, clearance) {
  cell.textContent = `${(1000 * clearance).toFixed(1)} mm`;
  cell.classList.toggle("bad", clearance < 0);
}

function start() {
  const data = JSON.parse(document.getElementById("replay-data").textContent);
  const replay = new Replay(data);
  window.cmbotReplay = {
    duration: data.duration,
    links: data.links,
    get time() { return replay.time; },
    get playing() { return replay.playing; },
    seek: (time) => replay.seek(time),
    play: () => replay.play(),
    pause: () => replay.pause(),
    pose: (link, arm = "planned") => replay.stage.pose(arm, data.links.indexOf(link)),
  };
}

try {
  start();
} catch (error) {
  const note = document.createElement("p");
  note.id = "failure";
  note.textContent = `The replay cannot be shown: ${error.message}. It needs a browser with WebGL.`;
  document.body.append(note);
  throw error;
}
