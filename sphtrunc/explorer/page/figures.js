// The five figures.

const PARTS = ["total", "smoothing", "discretisation", "disorder"];
const inX = (low, high, log) => scale(low, high, FRAME.left, FRAME.width - FRAME.right, log);
const inY = (low, high, log) => scale(low, high, FRAME.height - FRAME.bottom, FRAME.top, log);

/** Whole decades, of at most ten, that hold these values. */
function decades(values) {
  const shown = values.filter((v) => v > 0 && Number.isFinite(v));
  if (!shown.length) return [1e-3, 1];
  const top = 10 ** Math.ceil(Math.log10(Math.max(...shown)) + 1e-9);
  const bottom = 10 ** Math.floor(Math.log10(Math.min(...shown)) - 1e-9);
  return [Math.max(bottom, top * 1e-10, 1e-15), top];
}

function mark(x, y, at, value) {
  if (!(value >= y.low && value <= y.high)) return drawn("g");
  return drawn(
    "g",
    {},
    drawn("line", {
      class: "curve now",
      x1: x(at),
      x2: x(at),
      y1: FRAME.top,
      y2: FRAME.height - FRAME.bottom,
    }),
    drawn("circle", { class: "here", cx: x(at), cy: y(value), r: 5 }),
  );
}

function drawKernel({ kernel, dim, lattice, dxOverH }) {
  const names = [
    ["total", "w"],
    ["smoothing", "w′"],
    ["discretisation", "w″"],
  ];
  const n = 200;
  const at = Array.from({ length: n + 1 }, (_, i) => (i / n) * kernel.support * (1 - 1e-9));
  const values = names.map((_, m) => at.map((q) => kernel.shape(q, m)));
  const largest = values.map((row) => Math.max(...row.map(Math.abs)) || 1);
  const x = inX(0, kernel.support);
  const y = inY(-1.08, 1.08);
  const svg = picture();
  svg.append(axes(x, y, "q = r/h"));
  values.forEach((row, m) =>
    svg.append(
      curve(
        at.map((q, i) => [q, row[i] / largest[m]]),
        x,
        y,
        names[m][0],
      ),
    ),
  );
  const shells = [
    ...new Set(
      neighbours(lattice, dxOverH, kernel.support).map((s) => Math.hypot(...s).toFixed(9)),
    ),
  ]
    .map(Number)
    .sort((a, b) => a - b);
  for (const q of shells) {
    const base = FRAME.height - FRAME.bottom;
    svg.append(drawn("line", { class: "axis", x1: x(q), x2: x(q), y1: base, y2: base - 8 }));
  }
  const sigma = kernel.normalisation(dim);
  fill("figure-kernel", {
    title: "The kernel and its derivatives",
    picture: svg,
    says:
      `${kernel.name}: w, w′ and w″ against q from 0 to ${short(kernel.support)}, each over its` +
      ` largest value; particles of the lattice are at ${shells.length} distances.`,
    names,
    caption:
      `Each over its largest value. W(0) = ${short(sigma * kernel.shape(0), 6)} /` +
      `${powerText("h", String(dim))}. Short` +
      " lines on the axis: distances at which there are particles.",
    head: ["q", "Ŵ", "Ŵ′", "Ŵ″"],
    rows: () =>
      at
        .filter((_, i) => i % 10 === 0)
        .map((q) => [q, ...names.map((_, m) => sigma * kernel.shape(q, m))]),
  });
}

function drawLattice({ kernel, dim, lattice, dxOverH, hOverLambda }, name) {
  const reach = kernel.support * 1.3;
  const middle = [FRAME.width / 2, FRAME.height / 2 - 8];
  const unit = (FRAME.height / 2 - 14) / reach; // pixels per h
  const svg = picture();
  const points = neighbours(lattice, dxOverH, reach).sort(
    (a, b) => Math.abs(b[2] || 0) - Math.abs(a[2] || 0),
  );
  const dot = Math.max(1.2, Math.min(6, 0.22 * dxOverH * unit));
  for (const s of points) {
    const inside = Math.hypot(...s) <= kernel.support;
    const level = Math.abs(s[2] || 0) < 1e-9;
    if (!level && !inside) continue;
    const own = s.every((c) => c === 0);
    const kind = own ? "target" : !inside ? "outside" : level ? "particle" : "above";
    svg.append(
      drawn("circle", {
        class: kind,
        cx: middle[0] + s[0] * unit,
        cy: middle[1] - (s[1] || 0) * unit,
        r: own ? dot * 1.4 : level ? dot : dot * 0.6,
      }),
    );
  }
  const circle = (r, kind) =>
    drawn("circle", { class: `curve ${kind}`, cx: middle[0], cy: middle[1], r: r * unit });
  svg.append(circle(kernel.support, "total"), circle(1, "smoothing"));
  const base = FRAME.height - 14;
  svg.append(
    drawn("line", { class: "axis", x1: 8, x2: 8 + dxOverH * unit, y1: base, y2: base }),
    drawn("text", { x: 8, y: base - 5 }, "Δx"),
    drawn(
      "text",
      { x: FRAME.width - 8, y: base + 4, "text-anchor": "end" },
      `λ = ${short(1 / hOverLambda, 3)} h, ${short(1 / (hOverLambda * dxOverH), 3)} Δx`,
    ),
  );
  const within = points.filter((s) => Math.hypot(...s) <= kernel.support);
  const shells = new Map();
  for (const s of within) {
    const q = Math.hypot(...s).toFixed(6);
    shells.set(q, (shells.get(q) || 0) + 1);
  }
  const count = within.length;
  fill("figure-lattice", {
    title: `The neighbours: ${name}`,
    picture: svg,
    says:
      `${count} particles of the ${name} lattice within the support of ${short(kernel.support)} h,` +
      ` at Δx = ${short(dxOverH)} h, drawn to scale.`,
    names: [
      ["total", "support κh"],
      ["smoothing", "h"],
    ],
    caption:
      `${count} particles within the support, the target counted` +
      `${dim === 3 ? "; filled: in the plane of the target, rings: above or below it" : ""}.`,
    head: ["q = r/h", "particles"],
    rows: () => [...shells].sort((a, b) => a[0] - b[0]).map(([q, n]) => [Number(q), n]),
  });
}

/** The parts of the error along one thing, the present setting marked. */
function drawParts(id, { rows, title, label, here, error, caption, says }) {
  const shown = PARTS.filter((part) => part !== "disorder" || error.disorder > 0);
  const x = inX(rows[0].x, rows[rows.length - 1].x, true);
  const y = inY(...decades(rows.flatMap((row) => shown.map((part) => row[part]))), true);
  const svg = picture();
  svg.append(axes(x, y, label));
  for (const part of [...shown].reverse())
    svg.append(
      curve(
        rows.map((row) => [row.x, row[part]]),
        x,
        y,
        part,
      ),
    );
  svg.append(mark(x, y, here, error.total));
  fill(id, {
    title,
    picture: svg,
    says:
      `${says} Here it is ${short(error.total, 3)}; over the figure it goes from` +
      ` ${short(rows[0].total, 3)} to ${short(rows[rows.length - 1].total, 3)}.`,
    names: shown.map((part) => [part, part]),
    caption,
    head: [label, ...PARTS],
    rows: () => rows.map((row) => [row.x, ...PARTS.map((part) => row[part])]),
  });
}

function drawCurves(known, error) {
  const { dim, kernel, dxOverH, hOverLambda } = known;
  const count = BALL[dim] * (kernel.support / dxOverH) ** dim;
  drawParts("figure-wavelength", {
    rows: alongWavelength(known),
    title: "Error against h/λ",
    label: "h/λ",
    here: hOverLambda,
    error,
    caption:
      `At Δx/h = ${short(dxOverH)}. Where the total is level, a smaller h at this number of` +
      " neighbours gains nothing.",
    says: "The error against h over wavelength.",
  });
  drawParts("figure-neighbours", {
    rows: alongNeighbours(known),
    title: "Error against neighbours",
    label: "particles in the support",
    here: count,
    error,
    caption: `At h/λ = ${short(hOverLambda)}: more particles in the same support.`,
    says: "The error against the number of neighbours.",
  });
  drawPath(known, error);
}

function drawPath(known, error) {
  const { level, path } = alongRefinement(known);
  const { p, order, neighbours: growth } = pathOf(known);
  const last = level[level.length - 1].x;
  const x = inX(level[0].x, last, true);
  const y = inY(...decades([...level, ...path].map((row) => row.total)), true);
  const svg = picture();
  svg.append(
    axes(x, y, "particles per wavelength, λ/Δx"),
    curve(
      level.map((row) => [row.x, row.total]),
      x,
      y,
      "discretisation",
    ),
    curve(
      path.map((row) => [row.x, row.total]),
      x,
      y,
      "total",
    ),
    mark(x, y, level[0].x, error.total),
  );
  fill("figure-path", {
    title: "Which way to refine",
    picture: svg,
    says:
      `The error against particles per wavelength. With the present number of neighbours it goes from` +
      ` ${short(level[0].total, 3)} to ${short(level[level.length - 1].total, 3)}; along the best path to` +
      ` ${short(path[path.length - 1].total, 3)}.`,
    names: [
      ["total", `h ∝ ${powerText("Δx", p)}`],
      ["discretisation", "the present number of neighbours"],
    ],
    caption:
      `On disordered particles the best path of this form is, in the long run, h ∝ ` +
      `${powerText("Δx", p)}: the error falls as ${powerText("Δx", order)}, and neighbours grow as ` +
      `${powerText("N", growth)}. It ends at ${TABLES.most_neighbours[known.dim]} neighbours.`,
    head: ["λ/Δx", "present neighbours", "best path"],
    rows: () => level.map((row, i) => [row.x, row.total, path[i] ? path[i].total : ""]),
  });
}
