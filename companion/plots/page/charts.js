/* Charts of a flight: linked panels over time, a time line of states, a map without tiles.
   `flight` is the object of companion/plots/page.py; drawing is by uPlot, which draws the smallest
   and largest value of each pixel column, so that no peak is lost at any zoom. */
"use strict";
const FlightCharts = (() => {
  const UNKNOWN = -2147483648, AXIS = 70, GAP_S = 3, NEAR_S = 3;
  const INK = "#1a1a1a", FAINT = "#5f6368", GRID = "#e4e4e4";
  const LEVELS = {good: "#bfe3d0", warning: "#f3dfae", bad: "#eeb9ac", "": "#d7dce3"};
  const STEPS = [.01, .02, .05, .1, .2, .5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600,
                 7200, 14400, 43200, 86400];

  async function unpack(packed) {
    const bytes = Uint8Array.from(atob(packed.data), letter => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const size = planes.length / 4, tables = {};
    let at = 0;
    for (const [table, column, count, step] of packed.columns) {
      const values = new Array(count);
      for (let i = 0, whole = 0; i < count; i++, at++) {
        const folded = planes[at] | planes[size + at] << 8 | planes[2 * size + at] << 16
                       | planes[3 * size + at] << 24;
        whole = (whole + (folded >>> 1 ^ -(folded & 1))) | 0;
        values[i] = whole === UNKNOWN ? null : whole * step;
      }
      (tables[table] ??= {})[column] = values;
    }
    for (const table of Object.values(tables)) breakGaps(table);
    return tables;
  }

  /* A row of nulls where nothing came for so long that a line would claim too much. */
  function breakGaps(table) {
    const t = table.t, steps = [];
    for (let i = 1; i < t.length; i++) steps.push(t[i] - t[i - 1]);
    const usual = [...steps].sort((a, b) => a - b)[steps.length >> 1] ?? 0;
    const longest = Math.max(GAP_S, 5 * usual), places = [];
    steps.forEach((step, i) => { if (step > longest) places.push(i + 1); });
    for (const [name, values] of Object.entries(table)) {
      const wider = [];
      let from = 0;
      for (const place of places) {
        for (let i = from; i < place; i++) wider.push(values[i]);
        wider.push(name === "t" ? (t[place - 1] + t[place]) / 2 : null);
        from = place;
      }
      for (let i = from; i < values.length; i++) wider.push(values[i]);
      table[name] = wider;
    }
  }

  const decimals = step => [0, 1, 2, 3].find(each => Math.abs(step * 10 ** each - Math.round(step * 10 ** each)) < 1e-6) ?? 4;
  const two = number => String(Math.floor(number)).padStart(2, "0");
  function clock(seconds, decimals = 0) {
    const day = ((seconds % 86400) + 86400) % 86400;
    const rest = decimals ? "." + (day % 1).toFixed(decimals).slice(2) : "";
    return `${two(day / 3600)}:${two(day % 3600 / 60)}:${two(day % 60)}${rest}`;
  }
  function stamps(flight) {
    return flight.has_utc ? t => `${clock(t, 1)} UTC` : t => `${(t).toFixed(1)} s of the vehicle's clock`;
  }

  /* Viridis between its five points. */
  function viridis(share, points) {
    const place = Math.min(Math.max(share, 0), 1) * (points.length - 1), low = Math.floor(place);
    const part = place - low, high = Math.min(low + 1, points.length - 1);
    const mix = at => {
      const one = parseInt(points[low].slice(at, at + 2), 16);
      return Math.round(one + part * (parseInt(points[high].slice(at, at + 2), 16) - one));
    };
    return `rgb(${mix(1)},${mix(3)},${mix(5)})`;
  }

  function element(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  function swatch(style, shaded) {
    const dash = style.dash.map(each => each * style.width).join(" ");
    const svg = shaded
      ? `<rect width="26" height="10" fill="${style.colour}" opacity=".2"/>`
      : `<line x1="0" y1="5" x2="26" y2="5" stroke="${style.colour}" stroke-width="${Math.max(style.width, 1.2)}" stroke-dasharray="${dash}"/>`;
    const made = element("span", {class: "swatch"});
    made.innerHTML = `<svg width="26" height="10" aria-hidden="true">${svg}</svg>`;
    return made;
  }

  function build(flight, tables, host) {
    const charts = [], x0 = flight.start_s, all = {min: x0, max: x0 + Math.max(flight.duration_s, 1)};
    const stamp = stamps(flight), sync = uPlot.sync("flight"), marks = [];
    let zooming = false;

    function zoom(min, max) {
      const span = Math.max(max - min, .2), whole = all.max - all.min;
      if (span >= whole) [min, max] = [all.min, all.max];
      else {
        min = Math.min(Math.max(min, all.min), all.max - span);
        max = min + span;
      }
      zooming = true;
      for (const chart of charts) chart.setScale("x", {min, max});
      zooming = false;
      for (const mark of marks) mark.zoomed(min, max);
      return [min, max];
    }
    const range = () => charts.length ? charts[0].scales.x : all;
    function pan(share) {
      const {min, max} = range();
      zoom(min + share * (max - min), max + share * (max - min));
    }
    function scale(factor, at = .5) {
      const {min, max} = range(), centre = min + at * (max - min);
      zoom(centre - at * factor * (max - min), centre + (1 - at) * factor * (max - min));
    }
    const whole = () => zoom(all.min, all.max);

    /* Two fingers zoom, one moves what is zoomed; up and down scrolls the page. */
    function touch(chart) {
      const over = chart.over, fingers = new Map();
      let begun = null;
      over.style.touchAction = "pan-y";
      const places = () => [...fingers.values()].sort((a, b) => a - b);
      const start = () => { begun = fingers.size ? {at: places(), min: range().min, max: range().max} : null; };
      over.addEventListener("pointerdown", event => {
        if (event.pointerType !== "touch") return;
        fingers.set(event.pointerId, event.clientX);
        start();
      });
      over.addEventListener("pointermove", event => {
        if (!fingers.has(event.pointerId) || !begun) return;
        fingers.set(event.pointerId, event.clientX);
        const left = over.getBoundingClientRect().left, width = over.clientWidth;
        const span = begun.max - begun.min, now = places();
        if (now.length === 1) {
          const by = (begun.at[0] - now[0]) / width * span;
          zoom(begun.min + by, begun.max + by);
        } else if (now.length === 2 && begun.at.length === 2) {
          const [a, b] = begun.at.map(each => begun.min + (each - left) / width * span);
          const wider = span * Math.max(begun.at[1] - begun.at[0], 10) / Math.max(now[1] - now[0], 10);
          const middle = ((now[0] + now[1]) / 2 - left) / width;
          zoom((a + b) / 2 - middle * wider, (a + b) / 2 + (1 - middle) * wider);
        }
      });
      for (const name of ["pointerup", "pointercancel", "pointerleave"])
        over.addEventListener(name, event => { fingers.delete(event.pointerId); start(); });
    }

    function timeAxis() {
      return {
        stroke: FAINT, grid: {stroke: GRID, width: 1}, ticks: {stroke: GRID, size: 4}, space: 58,
        size: 26, font: "11px system-ui, sans-serif", incrs: STEPS,
        values: (_, splits, __, ___, step) => splits.map(
          each => flight.has_utc ? clock(each, step < 1 ? 2 : 0) : `${+each.toFixed(2)} s`),
      };
    }
    function shades(chart) {
      const {ctx, bbox} = chart, ratio = devicePixelRatio;
      const x = t => Math.min(Math.max(chart.valToPos(x0 + t, "x", true), bbox.left), bbox.left + bbox.width);
      ctx.save();
      ctx.font = `${10 * ratio}px system-ui, sans-serif`;
      ctx.textBaseline = "top";
      ctx.textAlign = "left";
      const colours = new Map();
      for (const [from, to, name] of flight.spans["flight mode"] ?? []) {
        if (!colours.has(name)) colours.set(name, flight.mode_shades[colours.size % flight.mode_shades.length]);
        ctx.fillStyle = colours.get(name);
        ctx.fillRect(x(from), bbox.top, x(to) - x(from), bbox.height);
        ctx.fillStyle = FAINT;
        if (x(to) - x(from) > ctx.measureText(name).width + 6 * ratio)
          ctx.fillText(name, x(from) + 3 * ratio, bbox.top + 3 * ratio);
      }
      for (const [from, to, name] of flight.spans.excluded ?? []) {
        ctx.fillStyle = "rgba(200, 60, 30, .18)";
        ctx.fillRect(x(from), bbox.top, Math.max(x(to) - x(from), ratio), bbox.height);
        ctx.fillStyle = "#8a2500";
        const text = `${name} excluded`;
        if (x(to) - x(from) > ctx.measureText(text).width + 6 * ratio)
          ctx.fillText(text, x(from) + 3 * ratio, bbox.top + 16 * ratio);
      }
      ctx.restore();
    }

    function panelData(panel) {
      const series = [], bands = [];
      const has = (table, column) => tables[table]?.[column] !== undefined;
      const add = (table, values, options) => { series.push({table, values, options}); return series.length - 1; };
      const edge = (band, sign) => {
        const half = tables[band.table][band.half], middle = band.middle && tables[band.table][band.middle];
        return half.map((each, i) => each === null || (middle && middle[i] === null)
          ? null : (middle ? middle[i] : 0) + sign * band.times * each);
      };
      const usable = band => has(band.table, band.half) && (!band.middle || has(band.table, band.middle));
      for (const band of panel.bands.filter(usable)) {
        const high = add(band.table, edge(band, 1), {hidden: true});
        const low = add(band.table, edge(band, -1), {hidden: true});
        bands.push({pair: [high, low], colour: band.colour});
        series[high].legend = {label: band.label, style: {colour: band.colour, dash: [], width: 1}, shaded: true, also: [low]};
      }
      for (const band of panel.edges.filter(usable)) {
        const style = {colour: band.colour, dash: [4, 2], width: 1};
        const high = add(band.table, edge(band, 1), {style}), low = add(band.table, edge(band, -1), {style});
        series[high].legend = {label: band.label, style, also: [low], size: tables[band.table][band.half]};
      }
      for (const line of panel.lines.filter(each => has(each.table, each.column))) {
        const at = add(line.table, tables[line.table][line.column], {style: line.style, markers: line.markers});
        series[at].legend = {label: line.style.label, style: line.style, also: []};
      }
      const names = [...new Set(series.map(each => each.table))];
      const groups = names.map(name => [tables[name].t.map(t => t + x0), ...series.filter(each => each.table === name).map(each => each.values)]);
      const joined = groups.length > 1
        ? uPlot.join(groups, groups.map(group => group.map(() => 1))) : groups[0];
      const sorted = names.flatMap(name => series.filter(each => each.table === name));
      const place = each => series.indexOf(each) + 1; /* drawn in this order: ours last, on top */
      const columns = [joined[0], ...series.map(each => joined[sorted.indexOf(each) + 1])];
      return {series, bands: bands.map(band => ({series: band.pair.map(at => place(series[at])), fill: band.colour + "2b"})), columns, place};
    }

    function drawPanel(panel) {
      const data = panelData(panel);
      if (!data.series.length) return;
      const figure = element("section", {class: "panel", id: `panel-${panel.name}`});
      const note = element("button", {class: "clipped", type: "button", hidden: ""});
      const help = element("details", {class: "help"}, element("summary", {"aria-label": "what this shows"}, "?"), element("p", {}, panel.help));
      figure.append(element("h3", {}, panel.title + (panel.unit ? ` (${panel.unit})` : "")), help, note);
      const canvas = element("div", {class: "canvas"}), legend = element("div", {class: "legend"});
      figure.append(canvas, legend);
      host.append(figure);
      let clips = panel.limits !== null;
      const yRange = (_, low, high) => {
        if (low === null || high === null) return [-panel.at_least || -1, panel.at_least || 1];
        const [floor, ceiling] = panel.limits ?? [low, high];
        const outside = panel.limits !== null && (low < floor - 1e-6 || high > ceiling + 1e-6);
        note.hidden = !outside;
        const extreme = -low > high ? low : (high - ceiling > floor - low ? high : low);
        note.textContent = clips ? `axis clipped: values reach ${extreme.toFixed(0)} ${panel.unit} (show all)` : "clip the axis again";
        if (clips && outside) [low, high] = [Math.max(low, floor), Math.min(high, ceiling)];
        if (low > high) [low, high] = [floor, ceiling];
        const middle = (low + high) / 2, half = Math.max((high - low) / 2 * 1.08, panel.at_least, 1e-3);
        return [panel.lowest ?? middle - half, panel.highest ?? Math.max(middle + half, (panel.lowest ?? -Infinity) + 2 * panel.at_least)];
      };
      const options = {
        width: canvas.clientWidth, height: panel.tall ? 300 : 170, legend: {show: false},
        padding: [8, 28, 0, 0],
        cursor: {sync: {key: sync.key, setSeries: false, scales: ["x", null]}, drag: {x: true, y: false, setScale: false},
                 points: {show: false}, y: false, bind: {dblclick: () => () => { whole(); return null; }}},
        scales: {x: {time: false, range: (_, low, high) => [low, high]}, y: {range: yRange}},
        axes: [timeAxis(), {stroke: FAINT, grid: {stroke: GRID, width: 1}, ticks: {show: false}, size: AXIS,
                            font: "11px system-ui, sans-serif",
                            values: (_, splits, __, ___, step) => splits.map(each => each.toFixed(decimals(step))) }],
        series: [{}, ...data.series.map(each => each.options.hidden
          ? {stroke: "transparent", width: 0, points: {show: false}, spanGaps: false}
          : {stroke: each.options.style.colour, width: each.options.markers ? 0 : each.options.style.width,
             dash: each.options.style.dash.map(part => part * each.options.style.width),
             paths: each.options.markers ? () => null : undefined,
             points: each.options.markers ? {show: true, size: 6, fill: each.options.style.colour} : {show: false},
             spanGaps: false})],
        bands: data.bands,
        hooks: {
          drawClear: panel.shades ? [shades] : [],
          setScale: [(chart, key) => {
            if (key === "x" && !zooming && charts.includes(chart)) zoom(chart.scales.x.min, chart.scales.x.max);
          }],
          setSelect: [chart => {
            const {left, width} = chart.select;
            if (width > 4) zoom(chart.posToVal(left, "x"), chart.posToVal(left + width, "x"));
            chart.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
          }],
          setCursor: [chart => readout(chart, panel, data, figure)],
        },
      };
      const chart = new uPlot(options, data.columns, canvas);
      note.addEventListener("click", () => { clips = !clips; chart.redraw(true, true); });
      note.addEventListener("click", () => chart.setScale("x", {...{min: chart.scales.x.min, max: chart.scales.x.max}}));
      for (const each of data.series.filter(each => each.legend)) {
        const value = element("output", {});
        const button = element("button", {type: "button", "aria-pressed": "true"}, swatch(each.legend.style, each.legend.shaded), each.legend.label, value);
        each.legend.value = value;
        button.addEventListener("click", () => {
          const show = button.getAttribute("aria-pressed") !== "true";
          button.setAttribute("aria-pressed", String(show));
          for (const one of [each, ...each.legend.also.map(at => data.series[at])]) chart.setSeries(data.place(one), {show});
        });
        legend.append(button);
      }
      touch(chart);
      keep(chart, canvas, panel.tall ? 300 : 170);
    }

    function keep(chart, canvas, height) {
      charts.push(chart);
      new ResizeObserver(() => { if (canvas.clientWidth) chart.setSize({width: canvas.clientWidth, height}); }).observe(canvas);
    }

    /* What each line is at the cursor: its last value, not older than NEAR_S. */
    function readout(chart, panel, data, figure) {
      const at = chart.cursor.idx, t = chart.data[0][at];
      for (const mark of marks) if (at != null) mark.at(t);
      for (const each of data.series.filter(each => each.legend?.value)) {
        const values = chart.data[data.place(each)];
        let found = null;
        for (let i = at; at != null && i >= 0 && t - chart.data[0][i] <= NEAR_S && found === null; i--) found = values[i] ?? null;
        if (found !== null && each.legend.also.length) {
          const low = chart.data[data.place(data.series[each.legend.also[0]])];
          for (let i = at; i >= 0 && t - chart.data[0][i] <= NEAR_S; i--)
            if (low[i] != null && values[i] != null) { found = (values[i] - low[i]) / 2; break; }
        }
        const sign = each.legend.also.length ? "±" : "";
        each.legend.value.textContent = found === null ? "" : ` ${sign}${found.toFixed(panel.digits)}`;
      }
      const clockAt = document.getElementById("cursor-time");
      if (clockAt && at != null && t !== undefined) clockAt.textContent = stamp(t);
    }

    /* States as rows of coloured spans. */
    function drawTimeline() {
      const names = Object.keys(flight.spans);
      if (!names.length) return;
      const row = 22, height = names.length * row + 36;
      const figure = element("section", {class: "panel", id: "panel-timeline"});
      const told = element("p", {class: "told"}, " ");
      figure.append(element("h3", {}, "Time line: modes, health, exclusions, verdicts"),
        element("details", {class: "help"}, element("summary", {"aria-label": "what this shows"}, "?"),
          element("p", {}, "Green: in order, or used. Yellow: degraded, or stale. Red: lost, excluded, rejected or invalid. Grey: neither good nor bad.")));
      const canvas = element("div", {class: "canvas"});
      figure.append(canvas, told);
      host.append(figure);
      const draw = chart => {
        const {ctx, bbox} = chart, ratio = devicePixelRatio, tall = bbox.height / names.length;
        const x = t => Math.min(Math.max(chart.valToPos(x0 + t, "x", true), bbox.left), bbox.left + bbox.width);
        ctx.save();
        ctx.font = `${11 * ratio}px system-ui, sans-serif`;
        ctx.textBaseline = "middle";
        ctx.textAlign = "left";
        names.forEach((name, at) => {
          const top = bbox.top + at * tall;
          for (const [from, to, what, level] of flight.spans[name]) {
            const left = x(from), wide = Math.max(x(to) - left, ratio);
            ctx.fillStyle = LEVELS[level];
            ctx.fillRect(left, top + 2 * ratio, wide, tall - 4 * ratio);
            ctx.fillStyle = INK;
            if (wide > ctx.measureText(what).width + 6 * ratio) ctx.fillText(what, left + 3 * ratio, top + tall / 2);
            if (level === "" && wide > 2 * ratio) ctx.fillRect(left, top + 2 * ratio, ratio, tall - 4 * ratio);
          }
        });
        ctx.restore();
      };
      const chart = new uPlot({
        width: canvas.clientWidth, height, legend: {show: false}, padding: [4, 28, 0, 0],
        cursor: {sync: {key: sync.key, setSeries: false, scales: ["x", null]}, drag: {x: true, y: false, setScale: false},
                 points: {show: false}, y: false, bind: {dblclick: () => () => { whole(); return null; }}},
        scales: {x: {time: false, range: (_, low, high) => [low, high]}, y: {range: [0, names.length]}},
        axes: [timeAxis(), {stroke: FAINT, size: AXIS, grid: {show: false}, ticks: {show: false}, font: "11px system-ui, sans-serif",
                            splits: () => names.map((_, at) => names.length - at - .5), values: () => names.map(each => each.replace("flight ", ""))}],
        series: [{}, {stroke: "transparent", width: 0, points: {show: false}}],
        hooks: {
          draw: [draw],
          setSelect: [chart => {
            const {left, width} = chart.select;
            if (width > 4) zoom(chart.posToVal(left, "x"), chart.posToVal(left + width, "x"));
            chart.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
          }],
          setCursor: [chart => {
            const t = chart.posToVal(chart.cursor.left, "x") - x0;
            const now = names.map(name => [name, flight.spans[name].find(([from, to]) => t >= from && t <= to)]).filter(each => each[1]);
            if (chart.cursor.left >= 0) told.textContent = now.map(([name, span]) => `${name}: ${span[2]}`).join(" · ") || " ";
          }],
        },
      }, [[all.min, all.max], [0, 0]], canvas);
      touch(chart);
      keep(chart, canvas, height);
    }

    /* The track over ground, drawn without tiles; its colour is the size of the altitude error. */
    function drawMap() {
      const track = tables.track;
      if (!track?.east_m || !track?.north_m) return;
      const known = track.t.map((_, i) => i).filter(i => track.east_m[i] !== null && track.north_m[i] !== null);
      const span = name => { let low = Infinity, high = -Infinity; for (const i of known) { low = Math.min(low, track[name][i]); high = Math.max(high, track[name][i]); } return [low, high]; };
      const [west, east] = span("east_m"), [south, north] = span("north_m");
      const errors = track.error_m ? known.map(i => track.error_m[i]).filter(each => each !== null).sort((a, b) => a - b) : [];
      const most = errors.length ? Math.max(errors[Math.floor(.98 * (errors.length - 1))], .5) : 0;
      const figure = element("section", {class: "panel", id: "panel-map"});
      const title = errors.length ? `Track over ground, coloured by the size of the altitude ${flight.error_word} (m)` : "Track over ground";
      figure.append(element("h3", {}, title), element("details", {class: "help"}, element("summary", {"aria-label": "what this shows"}, "?"),
        element("p", {}, "GNSS positions, north up, in metres from the first fix. The zoomed part of the flight is drawn thick; the ring is where the vehicle was at the cursor.")));
      const canvas = element("canvas", {class: "map", role: "img", "aria-label": title});
      figure.append(canvas);
      host.append(figure);
      const view = {min: all.min, max: all.max, at: null};
      const draw = () => {
        const wide = figure.clientWidth, tall = Math.min(Math.max(wide * .5, 260), 420), ratio = devicePixelRatio;
        if (!wide) return;
        canvas.width = wide * ratio; canvas.height = tall * ratio;
        canvas.style.height = `${tall}px`;
        const ctx = canvas.getContext("2d");
        ctx.scale(ratio, ratio);
        const bar = errors.length ? 64 : 10, pad = 16;
        const per = Math.min((wide - bar - 2 * pad) / Math.max(east - west, 5), (tall - 2 * pad - 18) / Math.max(north - south, 5));
        const px = i => pad + (wide - bar - 2 * pad) / 2 + (track.east_m[i] - (east + west) / 2) * per;
        const py = i => (tall - 18) / 2 - (track.north_m[i] - (north + south) / 2) * per;
        const within = i => track.t[i] + x0 >= view.min && track.t[i] + x0 <= view.max;
        ctx.lineCap = "round";
        for (const bold of [false, true]) for (let k = 1; k < known.length; k++) {
          const [a, b] = [known[k - 1], known[k]];
          if (within(b) !== bold || track.t[b] - track.t[a] > 10) continue;
          const error = track.error_m?.[b];
          ctx.strokeStyle = error == null ? "#999999" : viridis(error / most, flight.error_colours);
          ctx.globalAlpha = bold ? 1 : .25;
          ctx.lineWidth = bold ? 3.5 : 2;
          ctx.beginPath(); ctx.moveTo(px(a), py(a)); ctx.lineTo(px(b), py(b)); ctx.stroke();
        }
        ctx.globalAlpha = 1;
        ctx.fillStyle = INK; ctx.font = "11px system-ui, sans-serif";
        const circle = (i, radius, fill) => { ctx.beginPath(); ctx.arc(px(i), py(i), radius, 0, 7); if (fill) ctx.fill(); else { ctx.lineWidth = 2; ctx.strokeStyle = INK; ctx.stroke(); } };
        circle(known[0], 4, true); ctx.fillText("start", Math.min(px(known[0]) + 7, wide - bar - 34), py(known[0]) - 6);
        if (view.at !== null) { const i = known.findLast(k => track.t[k] + x0 <= view.at); if (i !== undefined) circle(i, 7, false); }
        const about = (wide - bar) / 5 / per, power = 10 ** Math.floor(Math.log10(about)), length = [5, 2, 1].map(k => k * power).find(each => each <= about);
        ctx.strokeStyle = INK; ctx.lineWidth = 2;
        ctx.beginPath(); ctx.moveTo(pad, tall - 10); ctx.lineTo(pad + length * per, tall - 10); ctx.stroke();
        ctx.fillText(length >= 1000 ? `${length / 1000} km` : `${length} m`, pad + length * per + 6, tall - 6);
        ctx.fillText("N ↑", pad, 14);
        if (errors.length) {
          const top = 26, high = tall - 60, left = wide - 54;
          for (let k = 0; k < high; k++) { ctx.fillStyle = viridis(1 - k / high, flight.error_colours); ctx.fillRect(left, top + k, 14, 1.5); }
          ctx.fillStyle = INK;
          for (const share of [0, .5, 1]) ctx.fillText(`${share === 1 && errors.at(-1) > most ? "≥" : ""}${(share * most).toFixed(most < 10 ? 1 : 0)}`, left + 18, top + (1 - share) * high + 4);
          ctx.fillText("m", left, top - 8);
        }
      };
      marks.push({at: t => { view.at = t; requestAnimationFrame(draw); }, zoomed: (min, max) => { Object.assign(view, {min, max}); requestAnimationFrame(draw); }});
      new ResizeObserver(draw).observe(figure);
      addEventListener("beforeprint", draw);
    }

    for (const panel of flight.panels.filter(each => each.tall)) drawPanel(panel);
    drawTimeline();
    drawMap();
    for (const panel of flight.panels.filter(each => !each.tall)) drawPanel(panel);
    whole();
    return {charts, zoom, pan, scale, whole, range};
  }
  return {unpack, build};
})();
