// Panels that zoom, linked under one cursor where they share an axis. Data stands in the page; uPlot draws it.
(function () {
  "use strict";
  const groups = document.querySelectorAll(".interactive");
  if (!groups.length || typeof uPlot === "undefined") return;
  document.documentElement.classList.add("live");  // shows the panels, which have a width then
  const night = window.matchMedia("(prefers-color-scheme: dark)");
  const AT_NIGHT = { "#0072B2": "#6dbbe6", "#D55E00": "#f08a3c", "#8a8a8a": "#9aa7b2", "#b8b8b8": "#7d8a95", "#555555": "#a3b1bd", "#f2c4a5": "#7a4a2a", "#a9cce3": "#2f566d" };
  const shade = (colour) => (night.matches && AT_NIGHT[colour]) || colour;
  const token = (name) => () => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const ink = token("--ink"), line = token("--line"), wash = token("--band");

  function number(value, unit) {
    return value === null || value === undefined ? "–" : `${Number(value.toPrecision(5))} ${unit}`;
  }

  function marked(marks) {
    return (u) => {
      const ctx = u.ctx, { left, top, width, height } = u.bbox;
      ctx.save();
      ctx.beginPath();
      ctx.rect(left, top, width, height);
      ctx.clip();
      for (const mark of marks) {
        const from = u.valToPos(mark.at, "x", true);
        if (mark.until === null) {
          ctx.strokeStyle = ink();
          ctx.setLineDash([6, 5]);
          ctx.beginPath();
          ctx.moveTo(from, top);
          ctx.lineTo(from, top + height);
          ctx.stroke();
        } else {
          ctx.fillStyle = wash();
          ctx.fillRect(from, top, u.valToPos(mark.until, "x", true) - from, height);
        }
      }
      ctx.restore();
    };
  }

  const all = [];
  groups.forEach((group, key) => {
    const { panels, linked, marks } = JSON.parse(group.querySelector("script.series").textContent);
    const places = group.querySelectorAll(".panel");
    const charts = [];
    const ends = panels.map((p) => [p.x[0], p.x[p.x.length - 1]]);
    if (linked) {
      const both = [Math.min(...ends.map((e) => e[0])), Math.max(...ends.map((e) => e[1]))];
      ends.forEach((_, i) => { ends[i] = both; });
    }
    ends.forEach((e, i) => { const edge = 0.01 * (e[1] - e[0]); ends[i] = [e[0] - edge, e[1] + edge]; });
    let setting = false;

    function show(i, min, max) {
      const [first, last] = ends[i];
      const least = (last - first) / 2000;
      const span = Math.min(Math.max(max - min, least), last - first);
      min = Math.min(Math.max(min, first), last - span);
      setting = true;
      charts.forEach((chart, j) => { if (linked || i === j) chart.setScale("x", { min: min, max: min + span }); });
      setting = false;
    }

    panels.forEach((panel, i) => {
      const bottom = !linked || i === panels.length - 1;
      const size = panel.x.length > 500 ? 3 : 5;
      const label = panel.axis_unit ? `${panel.axis} [${panel.axis_unit}]` : panel.axis;
      charts.push(new uPlot({
        width: places[i].clientWidth, height: linked ? (bottom ? 176 : 150) : 260,
        cursor: { sync: linked ? { key: `axis-${key}` } : undefined, drag: { x: true, y: false } },
        scales: { x: { time: false, range: (u, min, max) => {
          const [first, last] = ends[i], edge = 0.02 * (last - first);
          return min === max || (min < first + edge && max > last - edge) ? [first, last] : [min, max];
        } } },
        padding: [8, 16, 0, 0],  // the same in all, so that one cursor stands under the other
        legend: { live: true, markers: {
          width: 2, stroke: (u, j) => shade(panel.lines[j - 1].colour),
          fill: (u, j) => (panel.lines[j - 1].dots ? shade(panel.lines[j - 1].colour) : "transparent"),
        } },
        series: [
          { label: panel.axis, value: (u, v) => number(v, panel.axis_unit) },
          ...panel.lines.map((l) => ({
            label: l.label, stroke: () => shade(l.colour), width: l.dots ? 0 : 1.5,
            value: (u, v) => number(v, panel.unit),
            points: l.dots ? { show: true, size: size, fill: () => shade(l.colour), stroke: () => shade(l.colour), width: 0 } : { show: false },
            paths: l.dots ? () => null : undefined, spanGaps: false,
          })),
        ],
        axes: [
          {
            label: bottom ? label : undefined, labelSize: 22, size: bottom ? 34 : 6, stroke: ink,
            values: bottom ? undefined : (u, at) => at.map(() => ""),
            grid: { stroke: line, width: 1 }, ticks: { stroke: line, size: bottom ? 8 : 4 },
          },
          { size: 62, stroke: ink, grid: { stroke: line, width: 1 }, ticks: { stroke: line } },
        ],
        hooks: {
          drawClear: [marked(marks)],
          setScale: [(u, name) => {
            if (name === "x" && !setting && charts.length === panels.length) show(i, u.scales.x.min, u.scales.x.max);
          }],
        },
      }, [panel.x, ...panel.lines.map((l) => l.y)], places[i]));
      all.push([charts[i], places[i]]);
    });
    const moves = {
      in: (a, b) => [a + (b - a) / 4, b - (b - a) / 4], out: (a, b) => [a - (b - a) / 2, b + (b - a) / 2],
      earlier: (a, b) => [a - (b - a) / 2, b - (b - a) / 2], later: (a, b) => [a + (b - a) / 2, b + (b - a) / 2],
    };
    for (const button of group.querySelectorAll("button[data-move]")) {
      button.addEventListener("click", () => {
        (linked ? charts.slice(0, 1) : charts).forEach((chart, i) => {
          const x = chart.scales.x, move = moves[button.dataset.move];
          show(i, ...(move ? move(x.min, x.max) : ends[i]));
        });
      });
    }
  });
  window.addEventListener("resize", () => {
    for (const [chart, place] of all) chart.setSize({ width: place.clientWidth, height: chart.height });
  });
  night.addEventListener("change", () => { for (const [chart] of all) chart.redraw(false, true); });
})();
