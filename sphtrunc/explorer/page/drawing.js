// Drawing: elements, axes and curves as SVG, each figure with its numbers as a table.

const SVG = "http://www.w3.org/2000/svg";
const FRAME = { width: 360, height: 270, left: 46, right: 12, top: 10, bottom: 38 };

function element(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  return dressed(node, attributes, children);
}

function drawn(name, attributes = {}, ...children) {
  return dressed(document.createElementNS(SVG, name), attributes, children);
}

function dressed(node, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

const ROUNDING = 1e-14; // of the sums: what is smaller is no finding

/** A number for a person, with all its digits as the value for a program. */
function datum(x, digits = 4) {
  if (x === null) return element("span", {}, "none");
  const text = Math.abs(x) < ROUNDING && x ? "≈ 0" : short(x, digits).replaceAll("-", "−");
  return element("data", { value: String(x) }, text);
}

/** From a range of numbers to a range of the picture. */
function scale(low, high, from, to, log) {
  const f = log ? Math.log10 : (x) => x;
  const at = (x) => from + ((f(x) - f(low)) / (f(high) - f(low))) * (to - from);
  return Object.assign(at, { low, high, log });
}

/** Where an axis has its numbers. */
function ticks({ low, high, log }) {
  if (!log) {
    const raw = (high - low) / 4;
    const unit = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].find((n) => n * unit >= raw) * unit;
    const first = Math.ceil(low / step - 1e-9);
    const count = Math.floor(high / step + 1e-9) - first + 1;
    return Array.from({ length: count }, (_, i) => (first + i) * step);
  }
  const decades = Math.log10(high / low);
  const factors = decades > 3.5 ? [1] : decades > 1.2 ? [1, 3] : [1, 2, 5];
  const every = Math.max(1, Math.ceil(decades / 6));
  const found = [];
  for (let n = Math.floor(Math.log10(low)); n <= Math.log10(high); n++) {
    if (n % every) continue;
    for (const factor of factors) {
      const x = factor * 10 ** n;
      if (x >= low * (1 - 1e-9) && x <= high * (1 + 1e-9)) found.push(x);
    }
  }
  return found;
}

function tickText(x, log) {
  if (!log || (x >= 1e-2 && x < 1e4)) return short(x, 3).replace("-", "−");
  const n = Math.floor(Math.log10(x) + 1e-9);
  const factor = Math.round(x / 10 ** n);
  const up = String(n).replace(/[-0-9]/g, (c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[c]));
  return factor === 1 ? `10${up}` : `${factor}·10${up}`;
}

/** A power as it is read: Δx, Δx² or Δx^(2/5). */
function powerText(base, exponent) {
  if (exponent === "1") return base;
  return /^\d$/.test(exponent) ? base + "⁰¹²³⁴⁵⁶⁷⁸⁹"[exponent] : `${base}^(${exponent})`;
}

function axes(x, y, xLabel) {
  const { width, height, left, right, top, bottom } = FRAME;
  const group = drawn("g");
  for (const value of ticks(x)) {
    group.append(
      drawn("line", { class: "grid", x1: x(value), x2: x(value), y1: top, y2: height - bottom }),
      drawn(
        "text",
        { x: x(value), y: height - bottom + 14, "text-anchor": "middle" },
        tickText(value, x.log),
      ),
    );
  }
  for (const value of ticks(y)) {
    group.append(
      drawn("line", { class: "grid", x1: left, x2: width - right, y1: y(value), y2: y(value) }),
      drawn("text", { x: left - 4, y: y(value) + 4, "text-anchor": "end" }, tickText(value, y.log)),
    );
  }
  group.append(
    drawn("rect", {
      class: "axis",
      x: left,
      y: top,
      width: width - left - right,
      height: height - top - bottom,
    }),
    drawn(
      "text",
      { x: (left + width - right) / 2, y: height - 6, "text-anchor": "middle" },
      xLabel,
    ),
  );
  return group;
}

/** A curve through points [x, y]; it is interrupted where a point is not within the frame's numbers. */
function curve(points, x, y, name) {
  let path = "";
  let pen = "M";
  for (const [a, b] of points) {
    const inside = Number.isFinite(b) && (!y.log || b > 0) && b >= y.low && b <= y.high;
    path += inside ? `${pen}${x(a).toFixed(2)} ${y(b).toFixed(2)}` : "";
    pen = inside ? "L" : "M";
  }
  return drawn("path", { class: `curve ${name}`, d: path });
}

function legend(names) {
  const list = element("p", { class: "note" });
  for (const [name, text] of names) {
    const sample = drawn(
      "svg",
      { width: 34, height: 10, "aria-hidden": "true" },
      drawn("line", { class: `curve ${name}`, x1: 1, x2: 33, y1: 5, y2: 5 }),
    );
    list.append(element("span", { class: "key" }, sample, ` ${text}`), " ");
  }
  return list;
}

function tableOf(head, rows) {
  const said = (x) => (typeof x === "number" ? datum(x) : String(x));
  const row = (cells, kind, made) =>
    element("tr", {}, ...cells.map((x) => element(kind, {}, made(x))));
  return element(
    "table",
    {},
    element("thead", {}, row(head, "th", String)),
    element("tbody", {}, ...rows.map((cells) => row(cells, "td", said))),
  );
}

/** Fill a figure: title, picture that is described in words, legend, caption, and its numbers. */
function fill(id, { title, picture, says, names = [], caption, head, rows }) {
  const figure = document.getElementById(id);
  const open = figure.querySelector("details")?.open;
  picture.setAttribute("role", "img");
  picture.setAttribute("aria-label", says);
  const table = element("details", {}, element("summary", {}, "Numbers of this figure"));
  const write = () => {
    if (!table.open || table.querySelector("table")) return;
    const region = { tabindex: "0", role: "region", "aria-label": `Numbers: ${title}` };
    table.append(element("div", region, tableOf(head, rows())));
  };
  table.addEventListener("toggle", write);
  figure.replaceChildren(
    element("h3", {}, title),
    picture,
    legend(names),
    element("figcaption", {}, caption),
    table,
  );
  if (open) table.open = true;
}

function picture() {
  return drawn("svg", { viewBox: `0 0 ${FRAME.width} ${FRAME.height}` });
}
