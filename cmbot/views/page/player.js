// Sets arms and numbers for a time on the job's clock, and plays. `onTime` is called with every new time.
const TURN = Math.PI / 36;  // of the view by a key
const LONG = 120;  // s: what takes longer is played faster at first
const FAST = [10, 30, 100];  // further speeds of long jobs

// The speed at which a job of so many seconds is played at first.
const speedFor = (seconds) => [1, 2, 4, ...FAST].find((times) => seconds <= LONG * times) ?? FAST.at(-1);

// The largest torque on the base that is shown, Nm.
const peakOf = (phases, data) => Math.max(...phases.map((phase) => phase.peak), data.floor ?? 0);

class Player {
  constructor(data, onTime) {
    this.data = data;
    this.stage = new Stage(data);
    this.phases = phasesOf(data);
    for (const name of MOTIONS) this.addHalf(name);
    this.work = this.phases.find((phase) => phase.start === data.workStart && !phase.free);
    this.peak = peakOf(this.phases, data);
    this.stage.peak = this.peak;
    this.ui = Object.fromEntries([...document.querySelectorAll("[id]")].map((element) => [element.id, element]));
    this.onTime = onTime;
    this.playing = false;
    this.ui.scrub.min = data.start;
    this.ui.scrub.max = data.end;
    this.ui.bending.hidden = !data.bending;
    // A motion alone is compared with none.
    this.ui.compare.closest("label").hidden = MOTIONS.length === 1;
    for (const cell of document.querySelectorAll(".of-baseline")) cell.hidden = !MOTIONS.includes("baseline");
    if (!data.bending?.simulated) this.ui.bending.title = "Arm and rails bent by their static deflection, magnified; cmbot simulate adds vibration";
    const holds = this.work.motions[MOTIONS[0]].hold, strain = Math.max(...this.phases.map((phase) => phase.strain));
    if (holds) this.ui.colours.querySelector("[value=load]").textContent = "load and hold";
    if (strain > 0) this.stage.colours.top = roundedUp(strain);
    else this.ui.colours.querySelector("[value=strain]").remove();
    this.legend = new Legend(this.stage.colours, holds);
    this.offerSpeeds(data.end - data.start);
    this.connect();
    this.note(0);
    if (data.bending) this.offerFactors(data.bending.factors);
    this.showJob();
    this.seek(data.workStart);
  }

  connect() {
    const { ui, stage } = this;
    ui.play.addEventListener("click", () => (this.playing ? this.pause() : this.play()));
    ui.scrub.addEventListener("input", () => this.seek(Number(ui.scrub.value)));
    ui.reset.addEventListener("click", () => stage.resetView());
    ui.more.addEventListener("click", () => this.showMore(ui.bar.classList.toggle("open")));
    ui.compare.addEventListener("change", () => this.compare(ui.compare.value));
    ui.arrow.addEventListener("change", () => { stage.withArrow = ui.arrow.checked; stage.redraw(); });
    ui.colours.addEventListener("change", () => this.colour(ui.colours.value));
    ui.deflection.addEventListener("input", () => this.magnify(Number(ui.deflection.value)));
    window.addEventListener("keydown", (event) => this.onKey(event));
    stage.onDrawn = (part) => this.placeLabels(part);
    stage.onTurned = () => this.keepAddress();
    window.addEventListener("hashchange", () => this.follow(window.location.hash));
  }

  // Go where an address leads: a time and, behind a slash, the camera, such as report.html#12.5/x,y,z,x,y,z, from and to.
  follow(hash) {
    const [time, camera = ""] = hash.slice(1).split("/"), values = camera.split(",").map(Number);
    if (values.length === 6 && values.every(Number.isFinite)) this.stage.look(values);
    this.seek(Number(time || this.data.workStart));
  }

  // Keep time and camera in the page's address, once they rest. A page within another one has none of its own.
  keepAddress() {
    if (this.playing || window !== window.parent) return;
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => {
      const { stage, time, data } = this, short = (value) => Number(value.toFixed(3));
      const place = stage.turned ? `/${stage.place.map(short).join()}` : "";
      const hash = place || time !== data.workStart ? `#${short(time)}${place}` : "";
      const { pathname, search } = window.location;
      if (hash !== window.location.hash) window.history.replaceState(null, "", pathname + search + hash);
    }, 300);
  }

  offerSpeeds(seconds) {
    const { speed } = this.ui, first = speedFor(seconds);
    if (seconds > LONG) for (const times of FAST) speed.add(new Option(`${times} ×`, String(times)));
    speed.value = String(first);
  }

  // On a narrow page: all controls.
  showMore(open) {
    this.ui.more.setAttribute("aria-expanded", open);
    this.ui.more.textContent = open ? "Less" : "More";
    this.stage.refit();
  }

  // The name of a motion in its part of the view.
  addHalf(name) {
    const label = document.createElement("span");
    Object.assign(label, { id: `half-${name}`, className: `half ${name}`, hidden: true, textContent: motionName(name) });
    this.stage.view.append(label);
  }

  compare(how) {
    this.ui.compare.value = how;
    this.stage.setCompare(how);
    for (const label of document.querySelectorAll(".half")) label.hidden = how !== "beside";
    this.seek(this.time);
  }

  colour(kind) {
    this.ui.colours.value = kind;
    this.stage.colours.choose(kind);
    this.legend.choose(kind);
    this.stage.redraw();
  }

  // Begin with the factor at which the bending is well seen.
  offerFactors([factor, most]) {
    Object.assign(this.ui.deflection, { max: most, step: most < 100 ? 0.1 : 1, value: factor });
    this.magnify(factor);
  }

  magnify(factor) {
    if (!this.stage.bending) return;
    this.ui.factor.textContent = factor ? `× ${factor}` : "off";
    this.note(factor);
    this.stage.bending.factor = factor;
    this.stage.marks.setFactor(factor, this.work.motions);
    if (this.time !== undefined) this.seek(this.time);
  }

  // What of the picture is not as it is: by what factor deflections are drawn, and what is no obstacle.
  note(factor) {
    const bent = factor && (factor === 1 ? "bending drawn to scale" : `bending drawn × ${factor}`);
    const said = [bent, this.data.around && "pale parts are no obstacles"].filter(Boolean);
    this.ui.drawn.hidden = !said.length;
    this.put("drawn", said.join(", "));
  }

  // For a film, with the page's own factor where none is given, and without controls; the picture says by what factors deflections and time are drawn, and what its colours
  // mean.
  holdStill(wanted, speed, colours) {
    document.body.classList.add("film");
    if (this.ui.colours.querySelector(`[value=${colours}]`)) this.colour(colours);
    const factor = wanted ?? this.data.bending?.factors[0] ?? 1;
    this.magnify(factor);
    const bent = this.stage.bending && [factor === 0 ? "no deflections" : factor === 1 ? "deflections to scale" : `deflections × ${factor}`];
    this.put("magnified", [...(bent ?? []), speed !== 1 && `speed × ${speed}`].filter(Boolean).join(", "));
    this.stage.holdStill();
  }

  onKey(event) {
    const { target, key } = event;
    if (event.ctrlKey || event.altKey || event.metaKey || target.tagName === "SELECT") return;
    if (target === this.stage.view && this.onViewKey(key, event.shiftKey)) {
      event.preventDefault();
      return;
    }
    const step = event.shiftKey ? 1 : 0.1, { stage } = this;
    const onControl = target.tagName === "BUTTON" || target.type === "checkbox";
    const times = { ArrowLeft: this.time - step, ArrowRight: this.time + step, Home: this.data.start, End: this.data.end };
    if (key === "?") this.ui.help.togglePopover?.();
    else if (key.toLowerCase() === "b") stage.toggleAround();
    else if (key === " " && !onControl) this.playing ? this.pause() : this.play();
    else if (key in times && target.id !== "deflection") this.seek(times[key]);
    else return;
    event.preventDefault();
  }

  // Keys of the 3-D view, when it has the focus: arrows turn, with Shift they shift, + and - zoom, 0 shows all.
  onViewKey(key, shifted) {
    const { stage } = this, arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    if (key in arrows) {
      const [right, up] = arrows[key];
      if (shifted) stage.shift(0.05 * right, 0.05 * up);
      else stage.turn(TURN * right, -TURN * up);
    } else if (key === "+" || key === "=") stage.approach(1 / 1.15);
    else if (key === "-") stage.approach(1.15);
    else if (key === "0") stage.resetView();
    else return false;
    return true;
  }

  // The phase at a time, and how much of it is over.
  at(time) {
    const phase = this.phases.findLast((candidate) => time >= candidate.start) ?? this.phases[0];
    return [phase, Math.min(Math.max(phase.share(time), 0), 1)];
  }

  seek(time) {
    const { data, stage } = this;
    if (!Number.isFinite(time)) return;
    this.time = Math.min(Math.max(time, data.start), data.end);
    const [phase, moment] = this.at(this.time);
    for (const [name, motion] of Object.entries(phase.motions)) this.showMotion(name, motion, moment);
    const [label, begin, end] = this.part(phase);
    this.put("subtitle", [data.robot, label, `${(end - begin).toFixed(1)} of ${(data.end - data.start).toFixed(1)} s`].filter(Boolean).join(", "));
    this.ui.scrub.value = this.time;
    this.put("time", `${seconds(this.time)} / ${seconds(data.end)} s`);
    this.ui.scrub.setAttribute("aria-valuetext", `${seconds(this.time)} s`);
    this.onTime(this.time);
    this.keepAddress();
    stage.redraw();
  }

  // What the job does now, with begin and end: a phase with a label, or a part of the work.
  part({ label, start, end }) {
    const segment = label ? null : this.data.segments?.findLast(([, from]) => this.time >= from);
    return segment ?? [label, start, end];
  }

  showMotion(name, motion, moment) {
    const { stage } = this, near = motion.nearAt(moment);
    stage.arms[name].forEach((link, index) => motion.place(link, index, moment));
    stage.bending?.place(name, motion, moment);
    this.colourMotion(name, motion, moment);
    stage.torque[name] = motion.torqueAt(moment);
    stage.marks.setNear(name, near);
    stage.marks.setBent(name, motion, moment);
    this.put(`${name}-torque`, newtonMetres(stage.torque[name].length()));
    this.putClearance(`${name}-clearance`, motion.clearanceAt(moment));
    if (name === MOTIONS[0]) {
      const where = near ? this.data.pairs[near.pair] : "";
      this.put("near-label", near ? `${millimetres(near.distance)}, ${where}` : "");
    }
  }

  // What does not change with time: the largest torque and the smallest clearance of the whole job.
  showJob() {
    for (const name of MOTIONS) {
      const motions = this.phases.map((phase) => phase.motions[name]);
      this.put(`${name}-peak`, newtonMetres(Math.max(...motions.map((motion) => motion.peakTorque))));
      const clearances = motions.map((motion) => motion.minClearance).filter((value) => value !== null);
      this.putClearance(`${name}-closest`, clearances.length ? Math.min(...clearances) : null);
    }
  }

  colourMotion(name, motion, moment) {
    const { colours } = this.stage, hold = motion.hold && motion.numbersAt(motion.hold, moment)[0];
    colours.values[name] = { loads: [...motion.numbersAt(motion.load, moment), hold], u: motion.u && motion.numbersAt(motion.u, moment) };
    if (name !== MOTIONS[0] || colours.kind === "own") return;
    colours.paint(name);
    this.legend.update(colours.kind);
  }

  put(id, text) {
    if (this.ui[id]) this.ui[id].textContent = text;
  }

  putClearance(id, clearance) {
    this.put(id, millimetres(clearance));
    this.ui[id]?.classList.toggle("bad", clearance !== null && clearance < 0);
  }

  play() {
    if (this.playing) return;
    // A page opens where the work begins, with the arm out of its stow; what is played is the whole job.
    if (this.time >= this.data.end || this.time === this.data.workStart) this.seek(this.data.start);
    this.setPlaying(true);
    let last = performance.now();
    const advance = (now) => {
      if (!this.playing) return;
      // A tab that was in the background continues where it stopped.
      const passed = Math.min(Math.max(now - last, 0), 500) / 1000;
      last = now;
      this.seek(this.time + Number(this.ui.speed.value) * passed);
      if (this.time >= this.data.end) this.pause();
      else requestAnimationFrame(advance);
    };
    requestAnimationFrame(advance);
  }

  pause() {
    this.setPlaying(false);
    this.keepAddress();
  }

  setPlaying(playing) {
    this.playing = playing;
    this.ui.play.classList.toggle("playing", playing);
    this.ui.play.setAttribute("aria-label", playing ? "Pause" : "Play");
  }

  // Labels on a part of the view: the motion's name, and the planned motion's torque and smallest clearance.
  placeLabels(part) {
    const { ui, stage } = this, { left, top, wide, motion, above } = part;
    const bottom = 10 + stage.covered(stage.view.clientHeight)[1];
    ui.legend.style.bottom = `${bottom}px`;
    ui.drawn.style.bottom = `${bottom + (ui.legend.hidden ? 0 : 28)}px`;
    ui[`half-${motion}`].style.transform = `translate(${left + wide - 10}px, ${top + above + 10}px) translateX(-100%)`;
    if (motion !== MOTIONS[0]) return;
    const near = stage.marks.near[motion];
    this.put("torque-label", newtonMetres(stage.torque[motion].length()));
    this.placeLabel(ui["torque-label"], stage.arrow.tip, part, stage.withArrow);
    const between = near.from.clone().lerp(near.to, 0.5);
    for (const below of [34, 62, -30, -58]) {
      this.placeLabel(ui["near-label"], between, part, near.on, below);
      if (!near.on || !overlap(ui["torque-label"], ui["near-label"])) break;
    }
  }

  placeLabel(label, point, part, visible, below = 8) {
    label.hidden = !visible;
    const [x, y] = this.stage.onScreen(point, part), half = label.offsetWidth / 2 + 4;
    const across = Math.max(Math.min(x, part.left + part.wide - half), part.left + part.edge + half);
    const down = Math.min(y + below, part.top + part.high - part.below - label.offsetHeight - 4);
    // On whole pixels: between them text is blurred, and not always in the same way.
    label.style.transform = `translate(${Math.round(across - label.offsetWidth / 2)}px, ${Math.round(down)}px)`;
  }
}

// The place of some at which least is counted; undefined of none.
function leastHidden(places, count) {
  const counts = places.map(count);
  return places[counts.indexOf(Math.min(...counts))];
}

function overlap(...labels) {
  const [one, other] = labels.map((label) => label.getBoundingClientRect());
  return one.left < other.right && other.left < one.right && one.top < other.bottom && other.top < one.bottom;
}

// Adding zero turns -0 into 0.
const seconds = (value) => (Math.round(100 * value) / 100 + 0).toFixed(2);
const newtonMetres = (value) => `${value.toFixed(1)} Nm`;
const millimetres = (value) => (Number.isFinite(value) ? `${(1000 * value).toFixed(1)} mm` : "–");

// Start a page: `begin` makes a player of the data. Tests and the film control the page by `cmbotReplay`.
function start(begin) {
  try {
    const data = JSON.parse(document.getElementById("replay-data").textContent);
    nameMotions(data);
    const player = begin(data);
    player.follow(window.location.hash);
    window.cmbotReplay = {
      start: data.start,
      workStart: data.workStart,
      workEnd: data.workEnd,
      end: data.end,
      links: data.links,
      get time() { return player.time; },
      get playing() { return player.playing; },
      seek: (time) => player.seek(time),
      play: () => player.play(),
      pause: () => player.pause(),
      compare: (how) => player.compare(how),
      resetView: () => player.stage.resetView(),
      still: (factor = null, speed = 1, colours = "own") => player.holdStill(factor, speed, colours),
      stage: player.stage,
      draw: () => player.stage.render(),
      csv: () => player.downloads.csv(),
      ros: () => player.downloads.ros(),
      get camera() { return player.stage.place; },
      pose: (link, arm = "planned") => player.stage.pose(arm, data.links.indexOf(link)),
    };
  } catch (error) {
    const note = document.createElement("p");
    note.id = "failure";
    note.textContent = `The 3-D view cannot be shown: ${error.message.replace(/\.+$/, "")}. It needs a browser with WebGL.`;
    document.getElementById("view").append(note);
    throw error;
  }
}
