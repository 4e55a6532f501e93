// Unpacks the data of the page and draws the plots: for every pixel of the visible range the lowest,
// highest and last point, so that no spike of a single row is lost.
"use strict";

(async () => {
  const page = document.documentElement;
  const packed = document.getElementById("data");
  if (!packed || !packed.textContent.trim()) return;
  if (!("DecompressionStream" in window)) {
    document.getElementById("old").hidden = false;
    return;
  }

  // ---- Data -------------------------------------------------------------------------------------

  const text = atob(packed.textContent.trim());
  const deflated = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) deflated[i] = text.charCodeAt(i);
  packed.remove();
  const stream = new Blob([deflated]).stream().pipeThrough(new DecompressionStream("deflate"));
  const data = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(data.buffer).getUint32(0, true);
  const meta = JSON.parse(new TextDecoder().decode(data.subarray(4, 4 + length)));
  let at = 4 + length;

  // A column: the differences of its numbers, first all lowest bytes, then the next.
  function column(size) {
    const numbers = new Uint32Array(size);
    let sum = 0;
    for (let i = 0; i < size; i++) {
      const step = data[at + i] | (data[at + size + i] << 8) |
        (data[at + 2 * size + i] << 16) | (data[at + 3 * size + i] << 24);
      sum = (sum + step) >>> 0;
      numbers[i] = sum;
    }
    at += 4 * size;
    return numbers;
  }

  const all = meta.sizes.map((size) => {
    const units = column(size);
    const x = new Float64Array(size);
    for (let i = 0; i < size; i++) x[i] = meta.first + units[i] * meta.unit;
    return { x, y: new Int32Array(column(size).buffer) };
  });
  const motors = 4;
  const errors = all.slice(meta.traces, meta.traces + motors);
  const online = all.slice(meta.traces + motors, meta.traces + 2 * motors);
  const faults = all.slice(meta.traces + 2 * motors);

  function merged(numbers) {
    const parts = numbers.map((number) => all[number]);
    if (parts.length === 1) return parts[0];
    const points = parts.flatMap((one) => Array.from(one.x, (x, i) => [x, one.y[i]]));
    points.sort((a, b) => a[0] - b[0]);
    return { x: Float64Array.from(points, (p) => p[0]), y: Float64Array.from(points, (p) => p[1]) };
  }

  // A line that ends at each of the other times (NaN is drawn as a gap). One that holds its value
  // holds it until then, or until the end of the capture.
  function broken(line, others, holds) {
    const breaks = others.slice().sort((a, b) => a - b);
    const x = new Float64Array(line.x.length + 2 * breaks.length + 1);
    const y = new Float64Array(x.length);
    let n = 0, b = 0, open = false, value;
    const interrupt = (until) => {
      for (; b < breaks.length && breaks[b] <= until; b++) {
        if (open && holds) { x[n] = breaks[b]; y[n++] = value; }
        if (open) { x[n] = breaks[b]; y[n++] = NaN; }
        open = false;
      }
    };
    for (let i = 0; i < line.x.length; i++) {
      interrupt(line.x[i]);
      x[n] = line.x[i]; y[n++] = value = line.y[i]; open = true;
    }
    interrupt(Infinity);
    if (open && holds) { x[n] = meta.last; y[n++] = value; }
    return { x: x.subarray(0, n), y: y.subarray(0, n) };
  }

  // Times after which nothing is known: the next row is behind a gap, a lost port or a silence. A
  // silence is longer than a second, and than a few of the line's usual intervals.
  const JUST_AFTER = 1e-3, SILENCE = 1000, INTERVALS = 4;
  const gaps = meta.breaks.map((time) => time + JUST_AFTER);

  function silences({ x }) {
    if (x.length < 2) return [];
    const intervals = x.subarray(1).map((time, i) => time - x[i]).sort();
    const longest = Math.max(SILENCE, INTERVALS * intervals[intervals.length >> 1]);
    const found = [];
    for (let i = 1; i < x.length; i++) if (x[i] - x[i - 1] > longest) found.push(x[i - 1] + JUST_AFTER);
    return found;
  }

  // What is drawn of a line: all of it, or in the usual range without its outliers. An outlier ends
  // the value that holds before it.
  function drawnLine(name, line, limits, breaks, holds) {
    const [low, high] = limits ?? [-Infinity, Infinity];
    const select = (wanted) => {
      const found = Array.from(line.y.keys()).filter((i) => wanted(line.y[i]));
      return { x: Float64Array.from(found, (i) => line.x[i]), y: found.map((i) => line.y[i]) };
    };
    const outliers = select((y) => y < low || y > high);
    const whole = broken(line, breaks, holds);
    if (!outliers.x.length) return { name, whole, usual: whole, outliers };
    const ends = holds ? breaks.concat(Array.from(outliers.x)) : breaks;
    const usual = broken(select((y) => y >= low && y <= high), ends, holds);
    return { name, whole, usual, outliers };
  }

  // Intervals [left, right] in which the value of a series is not `sound`.
  function intervals(series, sound) {
    const found = [];
    for (let i = 0; i < series.x.length; i++) {
      if (series.y[i] !== sound) {
        const end = i + 1 < series.x.length ? series.x[i + 1] : meta.last;
        const before = found[found.length - 1];
        if (before && before[1] === series.x[i]) before[1] = end;
        else found.push([series.x[i], end]);
      }
    }
    return found;
  }

  // ---- What is drawn of a range ---------------------------------------------------------------------

  const SHORT = 4; // pixels

  function firstAfter(x, value) {
    let low = 0, high = x.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (x[middle] < value) low = middle + 1; else high = middle;
    }
    return low;
  }

  function envelope(line, low, high, pixels) {
    const { x, y } = line;
    const start = Math.max(0, firstAfter(x, low) - 1);
    const end = Math.min(x.length, firstAfter(x, high) + 1);
    if (end - start <= 4 * pixels) return { x: x.slice(start, end), y: y.slice(start, end) };
    const xs = [], ys = [], width = (high - low) / pixels;
    let n = 0;
    for (let i = start; i < end;) {
      const bin = Math.floor((x[i] - low) / width);
      const until = low + (bin + 1) * width;
      let least = -1, most = -1, nan = -1, j = i;
      for (; j < end && (x[j] < until || j === i); j++) {
        const value = y[j];
        if (value !== value) { nan = j; continue; }
        if (least < 0 || value < y[least]) least = j;
        if (most < 0 || value > y[most]) most = j;
      }
      let before = -1;
      for (const k of [least, most, nan, j - 1].sort((a, b) => a - b)) {
        if (k < 0 || k === before) continue;
        before = k;
        // A value that holds needs its first and last point.
        if (n > 1 && ys[n - 1] === y[k] && ys[n - 2] === y[k]) n--;
        xs[n] = x[k]; ys[n++] = y[k];
      }
      i = j;
    }
    return { x: xs, y: ys };
  }

  // The points of lines that are too short to be seen.
  function dots({ x, y }, pixel) {
    const found = { x: [], y: [] };
    for (let start = 0, end; start < y.length; start = end + 1) {
      for (end = start; end < y.length && y[end] === y[end];) end++;
      if (x[end - 1] - x[start] > SHORT * pixel) continue;
      for (let i = start; i < end; i++) { found.x.push(x[i]); found.y.push(y[i]); }
    }
    return found;
  }

  // Intervals that are less than a pixel apart become one; none is narrower than a pixel.
  function bands(found, low, high, pixel) {
    const left = [], right = [];
    for (const [start, end] of found) {
      if (end < low || start > high) continue;
      const last = right.length - 1;
      if (last >= 0 && start - right[last] < pixel) right[last] = Math.max(end, right[last]);
      else { left.push(start); right.push(Math.max(end, start + pixel)); }
    }
    return { left, right };
  }

  // At most one time for each pixel.
  function sparse(x, low, high, pixel) {
    const found = [];
    for (let i = firstAfter(x, low); i < x.length && x[i] <= high;) {
      found.push(x[i]);
      i = Math.max(i + 1, firstAfter(x, x[i] + pixel));
    }
    return found;
  }

  // ---- Plots ------------------------------------------------------------------------------------

  while (!window.Bokeh || !Bokeh.documents.length || !Bokeh.documents[0].is_idle) {
    await new Promise((resolve) => setTimeout(resolve, 10));
  }
  const models = Bokeh.documents[0];
  const source = (name) => models.get_model_by_name(name);
  const range = models.get_model_by_name("time");
  const whole = [range.start, range.end];
  const figures = models.roots().filter((root) => root.x_range === range);

  const timesOf = (numbers) => numbers.flatMap((number) => Array.from(all[number].x));

  const plots = meta.plots.filter((plot) => plot.name !== "faults").map((plot) => {
    if (plot.lines) {
      const others = timesOf(plot.others);
      const lines = Object.entries(plot.lines).map(([name, number]) =>
        drawnLine(`chassis-${name}`, all[number], plot.limits, others.concat(gaps), true));
      return { ...plot, lines, times: null };
    }
    const target = merged(plot.target), actual = merged(plot.actual);
    const others = timesOf(plot.others);
    const times = Float64Array.from(others.concat(Array.from(target.x))).sort();
    return {
      name: plot.name,
      limits: plot.limits,
      lines: [
        drawnLine(`${plot.name}-target`, target, plot.limits, others.concat(gaps), true),
        drawnLine(`${plot.name}-actual`, actual, plot.limits, gaps.concat(silences(actual)), false),
      ],
      error: intervals(errors[plot.number - 1], 0),
      offline: intervals(online[plot.number - 1], 1),
      times,
    };
  });
  const damage = meta.plots.find((plot) => plot.name === "faults");
  const figureOf = Object.fromEntries(figures.map((one) => [one.name, one]));

  let fullRange = false;

  // In the usual range, the farthest outlier of every few pixels is a mark at the edge.
  const MARK = 8; // pixels

  function drawOutliers(plot, low, high, pixel) {
    const drawn = { x: [], y: [], marker: [], colour: [], value: [] };
    for (const { name, outliers: { x, y } } of fullRange ? [] : plot.lines) {
      const colour = models.get_model_by_name(plot.name).renderers
        .find((one) => one.data_source.name === name).glyph.line_color.value;
      for (const above of [true, false]) {
        let farthest = -1;
        const mark = () => {
          if (farthest < 0) return;
          drawn.x.push(x[farthest]);
          drawn.y.push(above ? 0.96 : 0.09);
          drawn.marker.push(above ? "triangle" : "inverted_triangle");
          drawn.colour.push(colour);
          drawn.value.push(y[farthest]);
          farthest = -1;
        };
        let start = -Infinity;
        for (let i = firstAfter(x, low); i < x.length && x[i] <= high; i++) {
          if (y[i] > plot.limits[1] !== above) continue;
          if (x[i] >= start + MARK * pixel) { mark(); start = x[i]; }
          if (farthest < 0 || (y[i] > y[farthest]) === above) farthest = i;
        }
        mark();
      }
    }
    source(`${plot.name}-outliers`).data = drawn;
  }

  function drawLines(plot, low, high, pixels) {
    let least = Infinity, most = -Infinity;
    drawOutliers(plot, low, high, (high - low) / pixels);
    for (const { name, whole, usual } of plot.lines) {
      const drawn = envelope(fullRange ? whole : usual, low, high, pixels);
      for (let i = 0; i < drawn.y.length; i++) {
        if (drawn.y[i] < least) least = drawn.y[i];
        if (drawn.y[i] > most) most = drawn.y[i];
      }
      source(name).data = drawn;
      source(`${name}-dots`).data = dots(drawn, (high - low) / pixels);
    }
    const pad = Math.max(1, (most - least) * 0.06);
    if (least <= most) figureOf[plot.name].y_range.setv({ start: least - 1.5 * pad, end: most + pad });
  }

  function drawFaults(low, high, pixel) {
    const drawn = { x: [], y: [], size: [], colour: [], first: [], last: [] };
    damage.colours.forEach((colour, number) => {
      const { x } = faults[number];
      for (let i = firstAfter(x, low); i < x.length && x[i] <= high;) {
        const next = Math.max(i + 1, firstAfter(x, x[i] + 3 * pixel));
        drawn.x.push(x[i]);
        drawn.y.push(number);
        drawn.size.push(Math.min(14, 6 + 2 * Math.log2(next - i)));
        drawn.colour.push(colour);
        drawn.first.push([number, i]);
        drawn.last.push(next);
        i = next;
      }
    });
    source("faults-rows").data = drawn;
  }

  function draw(figure) {
    const low = range.start, high = range.end;
    const width = Math.max(200, document.getElementById("plots").clientWidth - 90);
    const pixel = (high - low) / width;
    const gaps = source(`${figure.name}-gap`);
    if (gaps) gaps.data = bands(meta.gaps, low, high, pixel);
    if (figure.name === "faults") return drawFaults(low, high, pixel);
    const plot = plots.find((one) => one.name === figure.name);
    drawLines(plot, low, high, width);
    if (!plot.times) return;
    for (const flag of ["error", "offline"]) {
      const drawn = source(`${plot.name}-${flag}`);
      if (drawn) drawn.data = bands(plot[flag], low, high, pixel);
    }
    source(`${plot.name}-commands`).data = { x: sparse(plot.times, low, high, 8 * pixel) };
  }

  // ---- Plots in sight ---------------------------------------------------------------------------

  // Other plots are drawn when they are about to come into sight; until then they are hidden if they
  // show another range.
  const NEAR = "300px 0px";
  const views = new Map(figures.map((figure) => [figure, Bokeh.index.find_one(figure)]));
  const near = new Set(), old = new Set(figures);

  function drawNear() {
    for (const [figure, view] of views) {
      figure.hold_render = !near.has(view.el);
      if (near.has(view.el) && old.delete(figure)) draw(figure);
      view.el.style.visibility = old.has(figure) ? "hidden" : "";
    }
  }

  const observer = new IntersectionObserver((entries) => {
    for (const one of entries) near[one.isIntersecting ? "add" : "delete"](one.target);
    drawNear();
    if (!page.dataset.drawn) page.dataset.drawn = 1;
  }, { rootMargin: NEAR });

  // In a microtask: after all changes, and before Bokeh paints.
  let waiting = false;
  function redraw() {
    if (waiting) return;
    waiting = true;
    queueMicrotask(() => {
      waiting = false;
      figures.forEach((figure) => old.add(figure));
      drawNear();
      if (page.dataset.drawn) page.dataset.drawn++;
    });
  }

  // ---- Rows of a fault ----------------------------------------------------------------------------

  const MOST_SHOWN = 20;

  function showRows(indices) {
    const body = document.querySelector("#rows tbody");
    body.replaceChildren();
    const drawn = source("faults-rows").data;
    for (const index of indices) {
      const [number, start] = drawn.first[index];
      const end = Math.min(drawn.last[index], start + MOST_SHOWN);
      for (let i = start; i < end; i++) {
        const row = meta.damaged[faults[number].y[i]];
        if (!row) continue;
        const line = document.createElement("tr");
        for (const cell of row) {
          const made = document.createElement("td");
          made.textContent = cell;
          line.append(made);
        }
        body.append(line);
      }
    }
    document.getElementById("rows").hidden = !body.children.length;
  }

  // ---- Legends ------------------------------------------------------------------------------------

  // Bokeh's own would be made anew at every change of the data.
  const hasOutliers = (plot) => plot.lines.some((line) => line.outliers.x.length > 0);
  const without = new Set(plots.filter((one) => !hasOutliers(one)).map((one) => `${one.name}-outliers`));
  function addLegend(figure) {
    const legend = document.createElement("div");
    legend.className = "legend";
    const named = figure.renderers.filter((one) => one.name && !without.has(one.data_source.name));
    for (const renderer of named) {
      const entry = document.createElement("label"), box = document.createElement("input");
      const mark = document.createElement("i"), name = document.createElement("span");
      const { line_color, fill_color, hatch_pattern, type } = renderer.glyph;
      box.type = "checkbox";
      box.checked = true;
      box.addEventListener("change", () => { renderer.visible = box.checked; });
      mark.className = type;
      if (hatch_pattern?.value) mark.classList.add("hatched");
      mark.style.backgroundColor = line_color.value || fill_color.value || "var(--faint)";
      name.textContent = renderer.name;
      entry.append(box, mark, name);
      legend.append(entry);
    }
    Bokeh.index.find_one(figure).el.before(legend);
  }
  models.roots().forEach(addLegend);

  // ---- Colours ----------------------------------------------------------------------------------

  function paint(dark) {
    const ink = dark ? "#d5d9e0" : "#24292f", faint = dark ? "#3a414c" : "#e1e4e8";
    const ground = dark ? "#161a20" : "#ffffff";
    for (const figure of models.roots()) {
      figure.setv({
        background_fill_color: ground, border_fill_color: ground, outline_line_color: faint,
      });
      for (const place of ["left", "below", "center"]) {
        for (const part of figure[place]) {
          const wanted = {
            axis_label_text_color: ink, major_label_text_color: ink, axis_line_color: faint,
            major_tick_line_color: faint, minor_tick_line_color: faint, grid_line_color: faint,
          };
          for (const [name, value] of Object.entries(wanted)) {
            if (name in part.properties) part[name] = value;
          }
        }
      }
    }
  }

  const preference = matchMedia("(prefers-color-scheme: dark)");
  preference.addEventListener("change", () => paint(preference.matches));
  const PAPER = 1040; // pixels between the margins of A4 in landscape
  addEventListener("beforeprint", () => {
    const width = document.getElementById("plots").clientWidth;
    page.style.setProperty("--print", Math.min(1, PAPER / width));
    paint(false);
    for (const view of views.values()) near.add(view.el);
    drawNear();
    for (const figure of models.roots()) Bokeh.index.find_one(figure).repaint();
  });
  addEventListener("afterprint", () => paint(preference.matches));
  paint(preference.matches);

  const full = document.getElementById("full");
  full.hidden = !plots.some(hasOutliers);
  full.addEventListener("click", () => {
    fullRange = !fullRange;
    full.setAttribute("aria-pressed", fullRange);
    redraw();
  });

  const showAll = () => range.setv({ start: whole[0], end: whole[1] });
  document.getElementById("whole").addEventListener("click", showAll);
  for (const link of document.querySelectorAll("a.finding")) {
    link.addEventListener("click", () => {
      const start = Number(link.dataset.start), end = Number(link.dataset.end);
      const around = Math.max(1000, (end - start) / 4);
      range.setv({
        start: Math.max(whole[0], start - around), end: Math.min(whole[1], end + around),
      });
    });
  }
  document.getElementById("plots").addEventListener("dblclick", showAll);
  if (damage) source("faults-rows").selected.change.connect(() => showRows(source("faults-rows").selected.indices));
  range.change.connect(redraw);
  addEventListener("resize", redraw);
  for (const view of views.values()) observer.observe(view.el);
})();
