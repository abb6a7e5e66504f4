// The replay page: the view fills the window, the torque is plotted above the slider.
start((data) => {
  const phases = phasesOf(data), plot = new TorquePlot(document.getElementById("plot"), data, phases, peakOf(phases, data));
  plot.draw(data.workStart);  // with or without a view
  const player = new Player(data, (time) => plot.draw(time));
  const seek = (event) => {
    if (event.buttons & 1) player.seek(plot.timeAt(event.clientX));
  };
  plot.canvas.addEventListener("pointerdown", seek);
  plot.canvas.addEventListener("pointermove", seek);
  const redraw = () => plot.draw(player.time);
  window.addEventListener("resize", redraw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  plot.draw(player.time);
  if (window !== window.parent) player.stage.scrollWithWheel();  // in a notebook
  player.downloads = new Downloads(player);
  return player;
});
