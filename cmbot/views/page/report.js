// The report page: plots beside the view, all at one time; for the printer the view becomes stills.
start((data) => {
  const charts = [], large = [];
  let player, now = data.workStart;
  const show = (time) => {
    now = time;
    for (const chart of charts) chart.show(time);
  };
  // Without a view there is no player, but there are plots.
  const seek = (time) => (player ? player.seek(time) : show(time));

  for (const spec of data.charts) {
    const chart = new Chart(spec, data, seek);
    document.getElementById(`charts-${spec.key}`).append(chart.figure);
    charts.push(chart);
  }
  const small = addJoints();
  charts.push(...small);

  // A row for each joint, a column for each quantity.
  function addJoints() {
    const grid = document.getElementById("joint-grid"), joints = data.joints.length;
    const quantities = data.jointCharts.filter((_, k) => k % joints === 0);
    const cell = (name, text, kind = "div") => {
      const element = document.createElement(kind);
      element.className = name;
      element.textContent = text;
      grid.append(element);
      return element;
    };
    grid.style.setProperty("--quantities", quantities.length);
    cell("corner", "");
    for (const { title, unit } of quantities) cell("heading", `${title}, ${unit}`);
    return data.joints.flatMap((joint, row) => {
      const onOpen = () => openJoint(row);
      const name = cell("joint", joint, "button");
      name.type = "button";
      name.addEventListener("click", onOpen);
      return quantities.map((quantity, column) => {
        const spec = data.jointCharts[column * joints + row];
        const chart = new Chart(spec, data, seek, { small: true, name: `${quantity.title} of ${joint}`, onOpen });
        grid.append(chart.figure);
        return chart;
      });
    });
  }

  // One joint's plots, large; the same joint again closes them.
  let opened = null;
  function openJoint(row) {
    const place = document.getElementById("joint-large"), joints = data.joints.length;
    for (const chart of large.splice(0)) charts.splice(charts.indexOf(chart), 1);
    place.replaceChildren();
    opened = opened === row ? null : row;
    place.hidden = opened === null;
    if (opened === null) return;
    for (const spec of data.jointCharts.filter((_, k) => k % joints === row)) {
      large.push(new Chart({ ...spec, title: `${spec.title} of ${data.joints[row]}` }, data, seek));
    }
    const close = document.createElement("button");
    close.type = "button";
    close.textContent = "Close";
    close.addEventListener("click", () => openJoint(row));
    place.append(close, ...large.map((chart) => chart.figure));
    charts.push(...large);
    for (const chart of large) chart.draw();
    seek(now);
    place.scrollIntoView({ block: "nearest" });
  }

  // Beside the plots the view fills the window down to the bar.
  function fitView() {
    const view = document.getElementById("view"), bar = document.getElementById("bar");
    const top = Math.max(view.parentElement.getBoundingClientRect().top, 10);
    const beside = window.matchMedia("(min-width: 901px)").matches && !window.matchMedia("(max-aspect-ratio: 1/1)").matches;
    view.style.height = beside ? `${Math.max(window.innerHeight - bar.offsetHeight - top - 12, 260)}px` : "";
  }
  fitView();
  window.addEventListener("scroll", fitView, { passive: true });
  window.addEventListener("resize", fitView);

  const drawAll = () => charts.forEach((chart) => chart.draw());
  let width = 0;
  new ResizeObserver(([entry]) => {
    if (Math.abs(entry.contentRect.width - width) < 1) return;
    width = entry.contentRect.width;
    drawAll();
    seek(now);
  }).observe(document.getElementById("plots"));

  const zoom = document.getElementById("zoom");
  zoom.addEventListener("change", () => {
    for (const chart of small) {
      chart.zoomed = zoom.checked;
      chart.draw();
    }
  });

  player = new Player(data, show);
  player.stage.scrollWithWheel();

  // On a phone the verdicts are folded to their first sentence: figures and view come soon.
  const verdicts = [...document.querySelectorAll("details.verdict")];
  if (window.matchMedia("(max-width: 640px)").matches) for (const each of verdicts) each.open = false;

  // On paper, pictures and plots have fixed sizes, px, whatever the window.
  const STILL = [440, 500], PLOT = 690, SMALL_PLOT = 112;
  window.addEventListener("beforeprint", () => {
    const before = now, stills = document.getElementById("stills");
    const { legTimes, workStart, workEnd } = data;
    const times = legTimes.length > 2 && legTimes.length <= 5 ? legTimes : [workStart, (workStart + workEnd) / 2, workEnd];
    player.pause();
    for (const each of verdicts) each.open = true;
    for (const chart of charts) chart.draw(chart.small ? SMALL_PLOT : PLOT);
    const giveBack = player.stage.borrowSize(...STILL);
    stills.replaceChildren(...times.map((time) => {
      player.seek(time);
      const figure = document.createElement("figure"), image = document.createElement("img"), caption = document.createElement("figcaption");
      image.src = player.stage.still();
      image.alt = caption.textContent = `t = ${seconds(time)} s`;
      figure.append(image, caption);
      return figure;
    }));
    giveBack();
    player.seek(before);
  });
  window.addEventListener("afterprint", drawAll);
  player.downloads = new Downloads(player);
  return player;
});
