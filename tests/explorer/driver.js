// Drives the page as a person does, setting by setting, and writes down what it shows.

const pause = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));

function put(id, value, kind) {
  const control = document.getElementById(id);
  control.value = value;
  control.dispatchEvent(new Event(kind, { bubbles: true }));
}

function choose(at) {
  const typed = ![...document.getElementById("kernel").options].some((o) => o.value === at.kernel);
  put("jitter", "0", "input"); // which the paired form needs before it can be chosen
  put("kernel", typed ? "own" : at.kernel, "change");
  if (typed) put("formula", at.kernel, "input");
  for (const id of ["dim", "lattice", "form", "correction"]) put(id, at[id], "change");
  for (const id of ["dx-over-h", "h-over-lambda", "jitter"]) put(id, at[id], "input");
}

async function settled() {
  do await pause(20);
  while (document.documentElement.dataset.state === "busy");
}

function shown() {
  const numbers = (selector) =>
    [...document.querySelectorAll(selector)].map((x) => Number(x.value));
  const [total, smoothing, discretisation, disorder] = numbers("#error data");
  const moments = numbers("#moments data");
  const rows = [...document.querySelectorAll("#conventions tbody tr")];
  return {
    state: document.documentElement.dataset.state,
    problem: document.getElementById("problem").textContent,
    hash: location.hash,
    summary: document.getElementById("summary").textContent,
    curves: [...document.querySelectorAll("figure path.total")].map(
      (x) => x.getAttribute("d").length,
    ),
    commands: [...document.querySelectorAll("#commands pre")].map((x) => x.textContent),
    error: { total, smoothing, discretisation, disorder },
    moments: [0, 2, 4, 6].map((i) => moments[i] + Number(i === 2)),
    spreads: [1, 3, 5, 7].map((i) => moments[i]),
    conventions: Object.fromEntries(
      rows.map((row) => [
        row.querySelector("code").textContent,
        row.querySelector("data") ? Number(row.querySelector("data").value) : null,
      ]),
    ),
  };
}

/** What assistive technology and a narrow window need. */
function manners() {
  const fields = [...document.querySelectorAll("input, select, textarea")];
  const ids = [...document.querySelectorAll("[id]")].map((x) => x.id);
  return {
    unnamed: fields
      .filter((x) => !x.labels.length && !x.getAttribute("aria-label"))
      .map((x) => x.id),
    pictures: [...document.querySelectorAll("figure > svg")].map((x) => [
      x.getAttribute("role"),
      x.getAttribute("aria-label").length,
    ]),
    live: document.querySelectorAll('[aria-live="polite"], [role="alert"]').length,
    doubled: ids.filter((id, i) => ids.indexOf(id) !== i),
    requests: performance.getEntriesByType("resource").map((x) => x.name),
    width: window.innerWidth,
    overflow: document.documentElement.scrollWidth - document.documentElement.clientWidth,
  };
}

(async () => {
  await settled();
  const found = { start: shown(), manners: manners(), settings: [] };
  for (const at of SETTINGS) {
    choose(at);
    await settled();
    found.settings.push(shown());
  }
  document.getElementById("formula").value = "0..1: alert(1)";
  put("kernel", "own", "change");
  put("formula", "0..1: alert(1)", "input");
  await settled();
  found.refused = shown();
  location.hash = "#kernel=spiky&dim=2";
  await pause(50);
  await settled();
  found.linked = shown();
  found.errors = ERRORS;
  parent.postMessage(JSON.stringify(found), "*");
})();
