"use strict";
// The live page: takes the server's events, shows the newest, says when it has none.

const STALE_S = 3;
const BROKEN_S = 1; // after a connection that has ended
const RETRY_MS = 1000;
const KEPT_ROWS = 1400;
const SENSORS = {
  pressure: "barometer", gnss: "GNSS", imu: "IMU", attitude: "attitude", range: "range finder",
  air: "air temperature", airspeed: "airspeed",
};
const FIXES = ["no GNSS", "no fix", "2D fix", "3D fix", "3D differential", "RTK float", "RTK fixed", "static", "PPP"];
const HEALTH_COLOURS = ["--good", "--warn", "--bad"];

const byId = (id) => document.getElementById(id);
const state = { rows: [], column: {}, lastEvent: 0, ageS: null, ended: false, source: null, offsetS: 0, hoverS: null, dirty: true };

// Values

function text(id, value) {
  const element = byId(id);
  if (element.textContent !== value) element.textContent = value;
}

const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
const fixed = (value, digits = 1) => (isNumber(value) ? value.toFixed(digits).replace(/^-(0(\.0+)?)$/, "$1") : "–");
const signed = (value, digits = 1) => (isNumber(value) && value.toFixed(digits) > 0 ? "+" : "") + fixed(value, digits);

function clock(unixS) {
  return new Date(unixS * 1000).toLocaleTimeString([], { hour12: false });
}

function list(id, items) {
  const key = JSON.stringify(items);
  const element = byId(id);
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  element.replaceChildren(...items.map(([head, body, kind]) => {
    const item = document.createElement("li");
    if (head) {
      const time = document.createElement("time");
      time.textContent = head;
      item.append(time);
    }
    const span = document.createElement("span");
    span.textContent = body;
    span.className = kind || "";
    item.append(span);
    return item;
  }));
}

// The state

function show(session, head) {
  const now = session.now;
  document.body.dataset.health = session.health.at_end;
  text("health-state", session.health.at_end);
  text("health-reason", session.health.reason);
  list("problems", [...session.problems, ...session.notes.slice(-3)].map((each) => ["", each]));
  text("vehicle", session.vehicle
    ? `${session.autopilot} ${session.vehicle} ${head.command === "replay" ? "in" : "on"} ${head.log}, ${session.estimator}`
    : `no vehicle heard ${head.command === "replay" ? "in" : "on"} ${head.log}`);
  text("altitude", fixed(now.altitude_m));
  text("altitude-ft", fixed(now.altitude_m / 0.3048, 0));
  text("sd", fixed(now.altitude_sd_m));
  text("level", fixed(now.level_m));
  text("above", fixed(now.above_takeoff_m));
  text("above-ft", fixed(isNumber(now.above_takeoff_m) ? now.above_takeoff_m / 0.3048 : null, 0));
  text("climb", signed(now.climb_mps));
  text("climb-fpm", signed(isNumber(now.climb_mps) ? now.climb_mps * 196.85 : null, 0));
  showAir(session);
  showSensors(session);
  showOutput(session);
  list("texts", session.texts.slice().reverse().map((each) => [
    clock(each.time_s), each.text.startsWith(each.from) ? each.text : `${each.from}: ${each.text}`,
    ["emergency", "alert", "critical", "error"].includes(each.severity) ? "bad" : each.severity === "warning" ? "warn" : "",
  ]));
  byId("exclusions-section").hidden = !session.exclusions.length;
  list("exclusions", session.exclusions.slice().reverse().map((each) => [
    `at ${fixed(each.boot_s, 0)} s`, `${SENSORS[each.sensor] || each.sensor} excluded for ${fixed(each.duration_s, 0)} s`,
  ]));
  const what = head.command === "replay" ? "a log, shown for" : "running for";
  text("about", `Kollsman ${head.kollsman}, ${what} ${duration(session.duration_s)}`);
  const number = isNumber(now.altitude_m) && session.health.at_end !== "LOST" ? `${fixed(now.altitude_m, 0)} m ` : "";
  document.title = `${number}${session.health.at_end} – Kollsman`;
}

function duration(s) {
  if (s < 120) return `${fixed(s, 0)} s`;
  return s < 7200 ? `${fixed(s / 60, 0)} min` : `${fixed(s / 3600, 1)} h`;
}

function showAir(session) {
  const { now, altitude } = session;
  text("qnh", fixed(altitude.qnh_hpa));
  text("qnh-sd", fixed(altitude.qnh_sd_hpa, 2));
  text("offset", signed(altitude.baro_offset_m));
  text("drift", signed(isNumber(now.baro_rate_mps) ? now.baro_rate_mps * 3600 : null));
  text("gnss-offset", signed(now.gnss_offset_m));
  const drifts = Object.entries(now.drift_probabilities).filter(([, share]) => isNumber(share));
  text("weather", drifts.map(([name, share]) => `${name}\u00a0${fixed(100 * share, 0)}\u00a0%`).join(", ") || "–");
}

function showSensors(session) {
  const rows = Object.entries(session.sensors).map(([kind, found]) => {
    const row = document.createElement("tr");
    const name = document.createElement("td");
    name.textContent = SENSORS[kind] || kind;
    const detail = sensorDetail(kind, found);
    if (detail) name.append(Object.assign(document.createElement("small"), { textContent: detail }));
    const verdict = Object.entries(found.verdicts).sort((a, b) => b[1] - a[1]);
    const total = verdict.reduce((sum, [, count]) => sum + count, 0);
    const words = verdict.filter(([, count]) => count >= 0.01 * total)
      .map(([each, count]) => (count > 0.99 * total ? each : `${each} ${Math.round((100 * count) / total)}\u00a0%`));
    const isLate = !isNumber(found.age_s) || found.age_s > 2;
    const isRefused = verdict.length && !["used", "ignored"].includes(verdict[0][0]);
    row.append(
      name,
      cell(isNumber(found.rate_hz) ? `${fixed(found.rate_hz, found.rate_hz < 10 ? 1 : 0)} Hz` : "–", "number"),
      cell(isNumber(found.age_s) ? `${fixed(found.age_s)} s` : "never", `number ${found.used && isLate ? "bad" : ""}`),
      cell(words.join(", ") || "silent", found.used && (isRefused || isLate) ? "bad" : ""),
    );
    return row;
  });
  byId("sensors").tBodies[0].replaceChildren(...rows);
}

function sensorDetail(kind, found) {
  if (kind === "gnss" && isNumber(found.fix_type)) {
    const parts = [FIXES[found.fix_type] || `fix type ${found.fix_type}`];
    if (found.satellites >= 0) parts.push(`${found.satellites} satellites`);
    if (isNumber(found.sd_m)) parts.push(`± ${fixed(found.sd_m)} m`);
    return parts.join(", ");
  }
  if (kind === "pressure" && isNumber(found.pressure_hpa)) return `${fixed(found.pressure_hpa, 2)} hPa`;
  if (kind === "range" && isNumber(found.distance_m)) return `${fixed(found.distance_m)} m`;
  return "";
}

function cell(value, kind) {
  return Object.assign(document.createElement("td"), { textContent: value, className: kind });
}

function showOutput(session) {
  const { now, feedback, link } = session;
  text("sends", now.sends === "none" ? "nothing sent yet" : now.sends === "ours" ? "our altitude" : now.sends);
  const why = feedback.phase === "ended" ? feedback.why_ended : feedback.hold;
  text("feedback", feedback.mode === "none" ? "off"
    : `${feedback.mode} ${feedback.phase}, ${signed(feedback.offset_m, 2)} m, ${feedback.writes} writes${why ? `: ${why}` : ""}`);
  text("frames", `${link.frames} heard, ${link.sent} sent (${session.altitude.published} ALTITUDE)`);
  const senders = Object.values(link.traffic).flatMap((each) => Object.values(each));
  const lost = senders.reduce((sum, each) => sum + each.lost, 0);
  const bad = Object.entries(link.rejected).map(([cause, count]) => `${cause} ${count}`).join(", ");
  text("lost", `${lost} lost${bad ? `; ${bad}` : ", nothing bad"}; link ${link.state}`);
  const radio = link.radio;
  for (const element of document.querySelectorAll(".radio")) element.hidden = !radio;
  if (!radio) return;
  const level = (value, noise) => `${value ?? "–"} (noise ${noise ?? "–"})`;
  const old = radio.age_s > 10 ? `, ${fixed(radio.age_s, 0)} s ago` : "";
  text("radio", `${level(radio.rssi, radio.noise)}, remote ${level(radio.remote_rssi, radio.remote_noise)}${old}`);
}

// The connection

function connect() {
  state.source?.close();
  const source = new EventSource("api/events");
  state.source = source;
  source.onopen = loadHistory;
  source.onmessage = (event) => take(JSON.parse(event.data));
  source.onerror = () => { // a refused connection is final for an EventSource
    if (state.source !== source) return;
    source.close();
    state.source = null;
    setTimeout(connect, RETRY_MS);
  };
}

async function loadHistory() {
  try {
    const found = await (await fetch("api/history")).json();
    found.columns.forEach((name, index) => { state.column[name] = index; });
    merge(found.rows);
  } catch {
    // the next connection brings it
  }
}

/** Add rows that are not known yet, in order of time. */
function merge(rows) {
  const known = new Set(state.rows.map((row) => row[0]));
  const added = rows.filter((row) => !known.has(row[0]));
  if (!added.length) return;
  state.rows = [...state.rows, ...added].sort((a, b) => a[0] - b[0]).slice(-KEPT_ROWS);
  state.dirty = true;
}

function take(event) {
  state.lastEvent = performance.now();
  state.ageS = event.age_s;
  if (event.ended && !state.ended) loadHistory();
  state.ended = Boolean(event.ended);
  if (!event.state) return;
  const newest = state.rows[state.rows.length - 1];
  if (newest && event.row[0] < newest[0] - 600) state.rows = []; // another log, or an earlier flight
  if (!newest || event.row[0] - newest[0] >= 0.45) {
    state.rows.push(event.row);
    if (state.rows.length > KEPT_ROWS) state.rows.splice(0, state.rows.length - KEPT_ROWS);
  }
  state.offsetS = event.state.time_s - performance.now() / 1000;
  show(event.state.sessions[0], event.state);
  state.dirty = true;
}

function watch() {
  const silentS = (performance.now() - state.lastEvent) / 1000;
  const hasEvent = state.lastEvent > 0 && (state.ageS !== null || state.rows.length > 0);
  const isLost = hasEvent && silentS > (state.source ? STALE_S : BROKEN_S);
  const isStalled = !isLost && !state.ended && state.ageS !== null && state.ageS + silentS > STALE_S;
  document.body.dataset.connection = !hasEvent ? "waiting" : isLost || isStalled ? "lost" : "live";
  text("connection-text", !hasEvent ? (state.lastEvent ? "the service starts" : "connecting") : isLost ? "not connected" : isStalled ? "service stalled" : state.ended ? "the log has ended" : "live");
  const stale = byId("stale");
  stale.hidden = !(isLost || isStalled);
  if (isLost) {
    stale.textContent = `No connection to Kollsman for ${fixed(silentS, 0)} s. What is shown below is old. Trying again ...`;
    document.title = "NOT CONNECTED – Kollsman";
  } else if (isStalled) {
    stale.textContent = `Kollsman has not reported for ${fixed(state.ageS + silentS, 0)} s. What is shown below is old.`;
    document.title = "STALLED – Kollsman";
  }
}

// The curves

const get = (name) => (row) => row[state.column[name]] ?? null;

function around(centre, half) {
  return (row) => {
    const middle = centre(row), side = half(row);
    return isNumber(middle) && isNumber(side) ? [middle - side, middle + side] : null;
  };
}

function minus(name) {
  return (row) => {
    const a = get(name)(row), b = get("altitude_m")(row);
    return isNumber(a) && isNumber(b) ? a - b : null;
  };
}

const twice = (name) => (row) => { const value = get(name)(row); return isNumber(value) ? 2 * value : null; };

/** A line of the project's style for a source. */
function line(source, value, label) {
  const style = STYLE[source];
  const dash = style.dash.map((each) => each * style.width);
  return { label: label || style.label, colour: `--${source}`, width: style.width, dash, value };
}

function makeCurves() {
  const figure = (name) => document.querySelector(`[data-curve="${name}"]`);
  const level = { label: "protection level", colour: "--estimate", opacity: 0.12 };
  const spread = { label: "95 % band", colour: "--estimate", opacity: 0.28 };
  return [
    new Curve(figure("altitude"), {
      least: 10, outliers: 0,
      strip: (row) => HEALTH_COLOURS[get("health")(row)] || "--quiet",
      bands: [{ ...level, edges: around(get("altitude_m"), get("level_m")) }],
      lines: [
        line("gnss", get("gnss_m")),
        line("baro", get("baro_m"), "raw barometer (1013 hPa)"),
        line("autopilot", get("autopilot_m")),
        line("estimate", get("altitude_m")),
      ],
    }),
    new Curve(figure("difference"), {
      least: 4, outliers: 0.01, zero: true,
      bands: [{ ...level, edges: around(() => 0, get("level_m")) }, { ...spread, edges: around(() => 0, twice("altitude_sd_m")) }],
      lines: [line("gnss", minus("gnss_m")), line("autopilot", minus("autopilot_m"))],
    }),
    new Curve(figure("climb"), {
      least: 2, outliers: 0, zero: true,
      lines: [line("estimate", get("climb_mps"))],
    }),
    new Curve(figure("qnh"), {
      least: 2, outliers: 0,
      bands: [{ ...spread, edges: around(get("qnh_hpa"), twice("qnh_sd_hpa")) }],
      lines: [line("estimate", get("qnh_hpa"), "QNH")],
    }),
  ];
}

function start() {
  const curves = makeCurves();
  const lastS = () => state.rows[state.rows.length - 1]?.[0] ?? 0;
  const nowS = () => (state.ended ? lastS() : performance.now() / 1000 + state.offsetS);
  const draw = () => {
    if (state.dirty && state.rows.length) {
      state.dirty = false;
      const fromS = nowS() - SPANS_S[SPANS_S.length - 1];
      const rows = state.rows.filter((row) => row[0] >= fromS);
      for (const curve of curves) curve.draw(rows, nowS(), state.hoverS);
    }
    requestAnimationFrame(draw);
  };
  for (const curve of curves) {
    curve.canvas.addEventListener("pointermove", (event) => {
      state.hoverS = curve.timeAt(event.clientX, nowS());
      state.dirty = true;
    });
    curve.canvas.addEventListener("pointerleave", () => { state.hoverS = null; state.dirty = true; });
  }
  addEventListener("resize", () => { state.dirty = true; });
  setInterval(watch, 250);
  connect();
  draw();
}

start();
