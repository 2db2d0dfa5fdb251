"use strict";
// Curves of the last ten minutes on canvases. Data: rows of the server's history, in its columns.

const SPANS_S = [60, 120, 300, 600]; // what the time axis shows: the shortest that holds all rows
const GAP_S = 4; // rows further apart are not joined, nor such that are GAP_STEPS usual steps apart
const GAP_STEPS = 5;

/** The smallest of 1, 2, 5 x 10^n that divides `span` into at most `most` steps. */
function niceStep(span, most) {
  const raw = Math.max(span / most, 1e-9);
  const power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].find((each) => each * power >= raw) * power;
}

/** Value below which the share `q` of `values` (not empty) lies. */
function quantile(values, q) {
  const sorted = Float64Array.from(values).sort();
  return sorted[Math.min(sorted.length - 1, Math.floor(q * sorted.length))];
}

const isKnown = (value) => value !== null && Number.isFinite(value);

/**
 * One canvas with its legend.
 * lines: {label, colour, width, dash, value(row) -> number|null}, the last drawn on top
 * bands: {label, colour, opacity, edges(row) -> [low, high]|null}
 * least: smallest height of the axis; strip(row) -> colour of the strip below; zero: draw y = 0
 */
class Curve {
  constructor(figure, options) {
    this.canvas = figure.querySelector("canvas");
    this.legend = figure.querySelector(".legend");
    Object.assign(this, { lines: [], bands: [], least: 1, strip: null, digits: 1 }, options);
    this.readings = [];
    for (const band of this.bands) this._key(band, band.colour, true);
    for (const line of [...this.lines].reverse()) this._key(line, line.colour, false);
    this.clipped = document.createElement("span");
    this.clipped.className = "clipped";
    this.legend.append(this.clipped);
  }

  _key(item, colour, isBand) {
    const entry = document.createElement("span");
    const sample = document.createElement("i");
    const shown = cssColour(colour);
    if (isBand) {
      sample.style.background = shown;
      sample.style.opacity = item.opacity * 2;
    } else {
      sample.style.height = "0";
      sample.style.verticalAlign = "0.25em";
      sample.style.borderTop = `${Math.max(2, item.width)}px ${item.dash.length ? "dashed" : "solid"} ${shown}`;
    }
    const value = document.createElement("b");
    entry.append(sample, `${item.label} `, value);
    this.legend.append(entry);
    if (isBand) value.remove();
    else this.readings.push([item, value]);
  }

  /** The range of the axis: all lines, and the bands without their widest quarter. */
  _range(rows) {
    const lineValues = [], low = [], high = [];
    for (const row of rows) {
      for (const line of this.lines) {
        const value = line.value(row);
        if (isKnown(value)) lineValues.push(value);
      }
      for (const band of this.bands) {
        const edges = band.edges(row);
        if (edges) { low.push(edges[0]); high.push(edges[1]); }
      }
    }
    if (!lineValues.length && !low.length) return null;
    const values = lineValues.length ? lineValues : [...low, ...high];
    let bottom = quantile(values, this.outliers), top = quantile(values, 1 - this.outliers);
    if (low.length) {
      bottom = Math.min(bottom, quantile(low, 0.25));
      top = Math.max(top, quantile(high, 0.75));
    }
    const pad = Math.max(0.06 * (top - bottom), 0.5 * (this.least - (top - bottom)), 1e-6);
    bottom -= pad;
    top += pad;
    const isClipped = [values, low, high].some((list) => list.some((v) => v < bottom || v > top));
    return { bottom, top, isClipped };
  }

  draw(rows, nowS, hoverS) {
    this.gapS = Math.max(GAP_S, GAP_STEPS * usualStep(rows)); // a log may be shown at any speed
    const ageS = rows.length ? nowS - rows[0][0] : 0;
    this.spanS = SPANS_S.find((each) => each >= ageS - 2) || SPANS_S[SPANS_S.length - 1];
    const ratio = window.devicePixelRatio || 1;
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    if (!width) return;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    const pen = this.canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    this.frame = { left: 52, right: width - 8, top: 8, bottom: height - 20 };
    const range = this._range(rows);
    this.clipped.textContent = range && range.isClipped ? "(axis clipped)" : "";
    this.x = (s) => this.frame.right - ((nowS - s) / this.spanS) * (this.frame.right - this.frame.left);
    this._timeAxis(pen, nowS);
    if (!range) {
      this._read(null);
      return;
    }
    const { bottom, top } = range;
    this.y = (v) => this.frame.bottom - ((v - bottom) / (top - bottom)) * (this.frame.bottom - this.frame.top);
    this._valueAxis(pen, bottom, top);
    pen.save();
    pen.beginPath();
    pen.rect(this.frame.left, this.frame.top, this.frame.right - this.frame.left, this.frame.bottom - this.frame.top);
    pen.clip();
    for (const band of this.bands) this._band(pen, band, rows);
    for (const line of this.lines) this._line(pen, line, rows);
    if (this.strip) this._strip(pen, rows);
    pen.restore();
    const read = hoverS === null ? rows[rows.length - 1] : nearest(rows, hoverS);
    if (hoverS !== null && read) this._cross(pen, read);
    this._read(read);
  }

  _read(row) {
    for (const [line, element] of this.readings) {
      const value = row ? line.value(row) : null;
      element.textContent = isKnown(value) ? value.toFixed(this.digits) : "–";
    }
  }

  _timeAxis(pen, nowS) {
    const { left, right, top, bottom } = this.frame;
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = cssColour("--quiet");
    pen.strokeStyle = cssColour("--line");
    pen.lineWidth = 1;
    pen.textBaseline = "top";
    const stepS = this.spanS / (right - left < 420 ? 2 : 5);
    for (let ago = 0; ago <= this.spanS; ago += stepS) {
      const x = Math.round(this.x(nowS - ago)) + 0.5;
      pen.beginPath();
      pen.moveTo(x, top);
      pen.lineTo(x, bottom);
      pen.stroke();
      pen.textAlign = ago === 0 ? "right" : ago === this.spanS ? "left" : "center";
      const label = this.spanS <= 120 ? `−${ago} s` : `−${ago / 60} min`;
      pen.fillText(ago === 0 ? "now" : label, x, bottom + 5);
    }
  }

  _valueAxis(pen, bottom, top) {
    const step = niceStep(top - bottom, Math.max(2, Math.floor((this.frame.bottom - this.frame.top) / 26)));
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let value = Math.ceil(bottom / step) * step; value <= top; value += step) {
      const y = Math.round(this.y(value)) + 0.5;
      pen.strokeStyle = cssColour(this.zero && Math.abs(value) < step / 2 ? "--quiet" : "--line");
      pen.beginPath();
      pen.moveTo(this.frame.left, y);
      pen.lineTo(this.frame.right, y);
      pen.stroke();
      pen.fillText((Math.abs(value) < step / 2 ? 0 : value).toFixed(digits), this.frame.left - 6, y);
    }
  }

  /** `rows` in pieces without gaps of time or of values. */
  *_pieces(rows, value) {
    let piece = [], lastS = null;
    for (const row of rows) {
      const found = value(row);
      const known = Array.isArray(found) || isKnown(found);
      if (piece.length && (!known || row[0] - lastS > this.gapS)) {
        yield piece;
        piece = [];
      }
      if (known) piece.push([row[0], found]);
      lastS = row[0];
    }
    if (piece.length) yield piece;
  }

  _line(pen, line, rows) {
    pen.strokeStyle = cssColour(line.colour);
    pen.lineWidth = line.width;
    pen.lineJoin = "round";
    pen.setLineDash(line.dash || []);
    for (const piece of this._pieces(rows, line.value)) {
      pen.beginPath();
      for (const [s, v] of piece) pen.lineTo(this.x(s), this.y(v));
      if (piece.length === 1) pen.lineTo(this.x(piece[0][0]) + 1, this.y(piece[0][1]));
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  _band(pen, band, rows) {
    pen.fillStyle = cssColour(band.colour);
    pen.globalAlpha = band.opacity;
    for (const piece of this._pieces(rows, band.edges)) {
      pen.beginPath();
      for (const [s, [, high]] of piece) pen.lineTo(this.x(s), this.y(high));
      for (const [s, [low]] of piece.reverse()) pen.lineTo(this.x(s), this.y(low));
      pen.fill();
    }
    pen.globalAlpha = 1;
  }

  _strip(pen, rows) {
    const { bottom } = this.frame;
    for (let k = 0; k < rows.length; k += 1) {
      const nextS = k + 1 < rows.length ? Math.min(rows[k + 1][0], rows[k][0] + this.gapS) : rows[k][0] + 0.5;
      pen.fillStyle = cssColour(this.strip(rows[k]));
      pen.fillRect(this.x(rows[k][0]), bottom - 6, Math.max(1, this.x(nextS) - this.x(rows[k][0]) + 0.5), 6);
    }
  }

  _cross(pen, row) {
    const x = Math.round(this.x(row[0])) + 0.5;
    pen.strokeStyle = cssColour("--ink");
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(x, this.frame.top);
    pen.lineTo(x, this.frame.bottom);
    pen.stroke();
  }

  /** Time at a pointer's place, or null beside the curves. */
  timeAt(clientX, nowS) {
    if (!this.frame) return null;
    const x = clientX - this.canvas.getBoundingClientRect().left;
    if (x < this.frame.left || x > this.frame.right) return null;
    return nowS - ((this.frame.right - x) / (this.frame.right - this.frame.left)) * this.spanS;
  }
}

/** The median time between two rows; 0 before there are some. */
function usualStep(rows) {
  const steps = [];
  for (let k = 1; k < rows.length; k += 1) steps.push(rows[k][0] - rows[k - 1][0]);
  return steps.length ? quantile(steps, 0.5) : 0;
}

/** The row whose time is nearest, or null when none is near. */
function nearest(rows, s) {
  let best = null;
  for (const row of rows) if (best === null || Math.abs(row[0] - s) < Math.abs(best[0] - s)) best = row;
  return best !== null && Math.abs(best[0] - s) <= GAP_S ? best : null;
}

/** The value of a CSS variable. */
function cssColour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
