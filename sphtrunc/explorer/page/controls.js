// The controls, the address, and what follows from them.

const byId = (id) => document.getElementById(id);
const OWN = "own"; // the choice of a kernel that is typed
const EXAMPLE = "0..1: 1 - 3/2*q^2 + 3/4*q^3; 1..2: (2-q)^3/4";
const STEPS = 1000;

/** key: label, what it means, its limits, and whether its slider is logarithmic. */
const SLIDERS = {
  "dx-over-h": {
    label: "Δx/h, particle spacing over smoothing length",
    limits: ({ kernel, dim }) => ratioLimits(kernel, dim),
    log: true,
  },
  "h-over-lambda": {
    label: "h/λ, smoothing length over wavelength",
    limits: () => TABLES.h_over_lambda,
    log: true,
  },
  jitter: { label: "σ/Δx, random displacement", limits: () => [0, TABLES.most_jitter], log: false },
};

let setting = settingOf(location.hash);
let pending = 0;

function offer(id, names, chosen) {
  const select = byId(id);
  const options = names.map((name) => element("option", { value: name }, name));
  select.replaceChildren(...options);
  select.value = chosen;
  select.disabled = names.length < 2;
}

function offerKernels() {
  const groups = new Map();
  for (const name of Object.keys(TABLES.kernels)) {
    const family = name.includes(":")
      ? name.split(":")[0]
      : name.startsWith("wendland")
        ? "Wendland"
        : "named";
    if (!groups.has(family)) groups.set(family, []);
    groups.get(family).push(element("option", { value: name }, name));
  }
  byId("kernel").replaceChildren(
    element("option", { value: OWN }, "type pieces …"),
    ...[...groups].map(([family, options]) => element("optgroup", { label: family }, ...options)),
  );
}

function offerSliders() {
  for (const [key, { label }] of Object.entries(SLIDERS)) {
    byId("sliders").append(
      element(
        "div",
        { class: "slider" },
        element("label", { for: key }, label),
        element("input", {
          type: "range",
          id: `${key}-slider`,
          min: 0,
          max: STEPS,
          "aria-label": label,
        }),
        element("input", { type: "text", id: key, inputmode: "decimal", spellcheck: "false" }),
      ),
    );
    byId(`${key}-slider`).addEventListener("input", (event) => {
      const [low, high] = limitsOf(key);
      const part = event.target.value / STEPS;
      const value = SLIDERS[key].log ? low * (high / low) ** part : low + (high - low) * part;
      change({ [key]: rounded(value, low, high) });
    });
    byId(key).addEventListener("input", (event) => change({ [key]: event.target.value }));
  }
}

/** Three digits, within the limits. */
function rounded(value, low, high) {
  const near = Number(value.toPrecision(3));
  const kept = near < low || near > high ? Number(value.toPrecision(6)) : near;
  return kept.toFixed(Math.max(0, 6 - Math.floor(Math.log10(kept || 1)))).replace(/\.?0+$/, "");
}

/** Of a slider; what is wrong elsewhere in the setting leaves those of the start. */
function limitsOf(key) {
  try {
    return SLIDERS[key].limits({ kernel: kernelOf(setting.kernel), dim: Number(setting.dim) });
  } catch {
    return SLIDERS[key].limits({ kernel: kernelOf(TABLES.start.kernel), dim: 3 });
  }
}

/** Take a change, keep the rest of the setting possible, and show it. */
function change(changes) {
  setting = { ...setting, ...changes };
  const lattice = TABLES.lattices[setting.lattice];
  if ("dim" in changes && (!lattice || String(lattice.dim) !== setting.dim)) {
    setting.lattice = TABLES.default_lattice[setting.dim];
  }
  if (!TABLES.forms[setting.form].includes(setting.correction)) setting.correction = "none";
  if ("kernel" in changes || "dim" in changes) keepRatio();
  show();
}

/** Δx/h goes to the nearest end of its range where another kernel or dimension has another range. */
function keepRatio() {
  const [low, high] = limitsOf("dx-over-h");
  try {
    const value = Rational.parse(setting["dx-over-h"]).toNumber();
    if (value < low || value > high) {
      setting["dx-over-h"] = rounded(Math.min(high, Math.max(low, value)), low, high);
    }
  } catch {
    // what is typed there is no number, which is said where it is used
  }
}

/** The controls say what the setting says; what somebody is typing is left alone. */
function showControls() {
  const own = !Object.hasOwn(TABLES.kernels, setting.kernel);
  byId("kernel").value = own ? OWN : setting.kernel;
  byId("own").hidden = !own;
  const put = (id, value) => {
    if (document.activeElement !== byId(id)) byId(id).value = value;
  };
  if (own) put("formula", setting.kernel);
  const lattices = Object.keys(TABLES.lattices).filter(
    (name) => String(TABLES.lattices[name].dim) === setting.dim,
  );
  offer("dim", ["1", "2", "3"], setting.dim);
  offer("lattice", lattices, setting.lattice);
  offer("form", Object.keys(TABLES.forms), setting.form);
  offer("correction", TABLES.forms[setting.form] || ["none"], setting.correction);
  for (const [key, { log }] of Object.entries(SLIDERS)) {
    put(key, setting[key]);
    const [low, high] = limitsOf(key);
    let value = low;
    try {
      value = Rational.parse(setting[key]).toNumber();
    } catch {
      continue;
    }
    const part = log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
    const slider = byId(`${key}-slider`);
    if (document.activeElement !== slider) slider.value = Math.round(STEPS * part);
    slider.setAttribute("aria-valuetext", setting[key]);
  }
}

/** Numbers at once, figures as soon as nothing else is to be done. */
function show() {
  document.documentElement.dataset.state = "busy";
  showControls();
  clearTimeout(pending);
  try {
    const known = understood(setting);
    const numbers = numbersOf(setting);
    showNumbers(known, numbers);
    drawKernel(known);
    drawLattice(known, setting.lattice);
    byId("problem").textContent = "";
    document.body.classList.remove("stale");
    pending = setTimeout(() => {
      history.replaceState(null, "", hashOf(setting)); // rarely: browsers allow few a second
      drawCurves(known, numbers.error);
      byId("summary").textContent = summary(known, numbers);
      document.documentElement.dataset.state = "ready";
    }, 40);
  } catch (error) {
    byId("problem").textContent = error.message;
    document.body.classList.add("stale");
    document.documentElement.dataset.state = "refused";
  }
}

function summary(known, { particles, error, moments }) {
  const part = PARTS.slice(1).reduce((a, b) => (error[b] > error[a] ? b : a));
  const advice = {
    smoothing: "a smaller h lowers it",
    discretisation: "more neighbours, or a smoother kernel, lower it",
    disorder: "a corrected form, more neighbours, or particles in better order lower it",
  };
  return (
    `${known.kernel.name} in ${known.dim}D with ${particles} particles in the support: at` +
    ` h/λ = ${short(known.hOverLambda)} the gradient is wrong by ${percent(error.total)}, mostly by` +
    ` ${part}: ${advice[part]}. M₁ − 1 = ${datum(moments[1] - 1, 3).textContent}.`
  );
}

function percent(x) {
  return x >= 1e-4 ? `${short(100 * x, 3)} %` : short(x, 3);
}

function showNumbers({ jitter, correction }, { moments, spreads, error, conventions }) {
  const most = Math.max(...Object.values(error)) || 1;
  const body = (id) => byId(id).querySelector("tbody");
  body("error").replaceChildren(
    ...PARTS.map((part) =>
      element(
        "tr",
        { "data-part": part },
        element("th", { scope: "row" }, part),
        element("td", {}, datum(error[part])),
        element(
          "td",
          {},
          drawn(
            "svg",
            { viewBox: "0 0 100 10", preserveAspectRatio: "none", "aria-hidden": "true" },
            drawn("line", {
              class: `curve ${part} bar`,
              x1: 0,
              x2: (100 * error[part]) / most,
              y1: 5,
              y2: 5,
            }),
          ),
        ),
      ),
    ),
  );
  const names = ["M₀", "M₁ − 1", "M₂", "M₃"];
  body("moments").replaceChildren(
    ...names.map((name, n) =>
      element(
        "tr",
        {},
        element("th", { scope: "row" }, name),
        element("td", {}, datum(moments[n] - Number(n === 1))),
        element("td", {}, datum(spreads[n])),
      ),
    ),
  );
  body("conventions").replaceChildren(
    ...Object.entries(TABLES.conventions).map(([name, { says, who }]) =>
      element(
        "tr",
        {},
        element("th", { scope: "row" }, element("code", {}, name)),
        element("td", {}, datum(conventions[name], 6)),
        element("td", {}, says, element("br"), element("small", {}, who)),
      ),
    ),
  );
  byId("validity").textContent = jitter
    ? "Disorder is of first order in σ: independent displacements of every particle, the target too, by" +
      ` σ = ${short(jitter)} Δx along each axis${correction === "none" ? "" : ", through the correction"}.` +
      " It was within 6 % of averages over displacements of any size, which sphtrunc measure" +
      " has, up to 0.1 Δx, and within 20 % up to 0.3 Δx, in the cases that were tried."
    : "On a lattice the numbers are right to about 13 digits; below 1e-14 they are rounding.";
  byId("commands").replaceChildren(
    ...commandsOf(setting).flatMap(([says, text]) => [
      element("p", {}, says),
      element("pre", { tabindex: "0" }, text),
    ]),
  );
}

offerKernels();
offerSliders();
byId("kernel").addEventListener("change", (event) =>
  change({ kernel: event.target.value === OWN ? EXAMPLE : event.target.value }),
);
byId("formula").addEventListener("input", (event) => change({ kernel: event.target.value }));
for (const id of ["dim", "lattice", "form", "correction"]) {
  byId(id).addEventListener("change", (event) => change({ [id]: event.target.value }));
}
byId("controls").addEventListener("submit", (event) => event.preventDefault());
byId("reset").addEventListener("click", () => change(TABLES.start));
byId("skip").addEventListener("click", (event) => {
  event.preventDefault();
  byId("results-start").focus();
});
window.addEventListener("hashchange", () => {
  setting = settingOf(location.hash);
  show();
});
show();
