// Panels over time that zoom together under one cursor. Data stands in the page; uPlot draws it.
(function () {
  "use strict";
  const holder = document.getElementById("panels");
  if (!holder || typeof uPlot === "undefined") return;
  const panels = JSON.parse(document.getElementById("series").textContent);
  document.documentElement.classList.add("live");  // shows the panels, which have a width then
  const charts = [];
  let setting = false;
  const first = Math.min(...panels.map((p) => p.t[0]));
  const last = Math.max(...panels.map((p) => p.t[p.t.length - 1]));

  function show(min, max) {
    const span = Math.min(Math.max(max - min, 1), last - first);
    min = Math.min(Math.max(min, first), last - span);
    setting = true;
    for (const chart of charts) chart.setScale("x", { min: min, max: min + span });
    setting = false;
  }

  function number(value, unit) {
    return value === null || value === undefined ? "–" : `${Number(value.toPrecision(5))} ${unit}`;
  }

  panels.forEach((panel, i) => {
    const place = document.getElementById(`panel-${i}`);
    const bottom = i === panels.length - 1;
    charts.push(new uPlot({
      width: place.clientWidth, height: bottom ? 176 : 150,
      cursor: { sync: { key: "time" }, drag: { x: true, y: false } },
      scales: { x: { time: false } },
      legend: { live: true },
      series: [
        { label: "time", value: (u, v) => number(v, "s") },
        ...panel.lines.map((line) => ({
          label: line.label, stroke: line.colour, width: line.dots ? 0 : 1.5,
          value: (u, v) => number(v, panel.unit),
          points: line.dots ? { show: true, size: 3, fill: line.colour, stroke: line.colour, width: 0 } : { show: false },
          paths: line.dots ? () => null : undefined, spanGaps: false,
        })),
      ],
      axes: [
        { show: bottom, label: "time [s]", labelSize: 22, size: 34, grid: { stroke: "#e4e4e4", width: 1 } },
        { size: 62, grid: { stroke: "#e4e4e4", width: 1 } },
      ],
      hooks: {
        setScale: [(u, key) => {
          if (key === "x" && !setting && charts.length === panels.length) show(u.scales.x.min, u.scales.x.max);
        }],
      },
    }, [panel.t, ...panel.lines.map((line) => line.y)], place));
  });
  const moves = {
    in: (a, b) => [a + (b - a) / 4, b - (b - a) / 4], out: (a, b) => [a - (b - a) / 2, b + (b - a) / 2],
    earlier: (a, b) => [a - (b - a) / 2, b - (b - a) / 2], later: (a, b) => [a + (b - a) / 2, b + (b - a) / 2],
    whole: () => [first, last],
  };
  for (const button of document.querySelectorAll("button[data-move]")) {
    button.addEventListener("click", () => {
      const x = charts[0].scales.x;
      show(...moves[button.dataset.move](x.min, x.max));
    });
  }
  window.addEventListener("resize", () => {
    charts.forEach((chart, i) => {
      chart.setSize({ width: document.getElementById(`panel-${i}`).clientWidth, height: chart.height });
    });
  });
})();
