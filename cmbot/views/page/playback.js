// Time: what the arms, the numbers and the plot show at a moment, and how the moment changes. The work starts at
// time 0, the approach before it.
class Replay {
  constructor(data) {
    this.data = data;
    this.stage = new Stage(data);
    this.phases = phasesOf(data);
    this.peak = Math.max(...this.phases.map((phase) => phase.peak), data.floor ?? 0);
    this.ui = Object.fromEntries([...document.querySelectorAll("[id]")].map((element) => [element.id, element]));
    this.plot = new TorquePlot(this.ui.plot, data, this.phases, this.peak);
    this.playing = false;
    this.ui.scrub.min = data.start;
    this.ui.scrub.max = data.duration;
    this.connect();
    this.seek(0);
  }

  connect() {
    const { ui, stage } = this;
    ui.play.addEventListener("click", () => (this.playing ? this.pause() : this.play()));
    ui.scrub.addEventListener("input", () => this.seek(Number(ui.scrub.value)));
    ui.reset.addEventListener("click", () => stage.resetView());
    ui.ghost.addEventListener("change", () => { stage.ghost.visible = ui.ghost.checked; stage.redraw(); });
    ui.arrow.addEventListener("change", () => { stage.arrow.group.visible = ui.arrow.checked; stage.redraw(); });
    const seekOnPlot = (event) => {
      if (event.buttons & 1) this.seek(this.plot.timeAt(event.clientX));
    };
    ui.plot.addEventListener("pointerdown", seekOnPlot);
    ui.plot.addEventListener("pointermove", seekOnPlot);
    window.addEventListener("keydown", (event) => this.onKey(event));
    window.addEventListener("resize", () => this.plot.draw(this.time));
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
    else if (key === "Home") this.seek(this.data.start);
    else if (key === "End") this.seek(this.data.duration);
    else return;
    event.preventDefault();
  }

  seek(time) {
    const { data, stage, ui } = this;
    if (!Number.isFinite(time)) return;
    this.time = Math.min(Math.max(time, data.start), data.duration);
    const phase = this.phases.findLast((candidate) => this.time >= candidate.start);
    const moment = phase.share(this.time);
    for (const [name, motion] of Object.entries(phase.motions)) {
      stage.arms[name].forEach((link, index) => motion.place(link, index, moment));
      ui[`${name}-torque`].textContent = newtonMetres(motion.torqueAt(moment).length());
      show(ui[`${name}-clearance`], motion.clearanceAt(moment));
      ui[`${name}-peak`].textContent = newtonMetres(motion.peakTorque);
      show(ui[`${name}-closest`], motion.minClearance);
    }
    const torque = phase.motions.planned.torqueAt(moment);
    stage.showTorque(torque, torque.length() / this.peak);
    ui["torque-label"].textContent = newtonMetres(torque.length());
    const words = [data.robot, phase.label, `${(phase.end - phase.start).toFixed(1)} s`];
    ui.subtitle.textContent = words.filter(Boolean).join(", ");
    ui.scrub.value = this.time;
    ui.time.textContent = `${seconds(this.time)} / ${seconds(data.duration)} s`;
    this.plot.draw(this.time);
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
}

// Adding zero turns -0 into 0.
const seconds = (value) => (Math.round(100 * value) / 100 + 0).toFixed(2);

function show(cell, clearance) {
  cell.textContent = `${(1000 * clearance).toFixed(1)} mm`;
  cell.classList.toggle("bad", clearance < 0);
}

function start() {
  const data = JSON.parse(document.getElementById("replay-data").textContent);
  const replay = new Replay(data);
  window.cmbotReplay = {
    start: data.start,
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
