// The same numbers elsewhere: what to type in a terminal and in Python.

/** A word as a shell takes it. */
function quoted(word) {
  return /^[\w@%+=:,.\/-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
}

function options(setting) {
  const words = ["--kernel", setting.kernel, "--dim", setting.dim];
  if (setting.lattice !== TABLES.default_lattice[setting.dim])
    words.push("--lattice", setting.lattice);
  if (setting.form !== "standard") words.push("--form", setting.form);
  if (setting.correction !== "none") words.push("--correction", setting.correction);
  words.push("--dx-over-h", setting["dx-over-h"]);
  if (Rational.parse(setting.jitter).top) words.push("--jitter", setting.jitter);
  return words.map(quoted).join(" ");
}

/** [what it gives, the text] of every way. */
function commandsOf(setting) {
  const link = quoted(hashOf(setting));
  const text = (x) => JSON.stringify(x);
  return [
    ["These very numbers, in the terminal", `sphtrunc explore --numbers ${link}`],
    [
      "The moments, exactly, and where they come from",
      `sphtrunc derive ${options(setting)} --degree 3`,
    ],
    [
      "The error, predicted and measured on particles",
      `sphtrunc measure ${options(setting)} --h-over-lambda ${setting["h-over-lambda"]}`,
    ],
    [
      "h in other words",
      `sphtrunc convert --kernel ${quoted(setting.kernel)} --dim ${setting.dim} --dx-over-h ${setting["dx-over-h"]}`,
    ],
    [
      "These very numbers, in Python",
      [
        "from sphtrunc.explorer.setting import Setting, numbers",
        "",
        `at = Setting(kernel=${text(setting.kernel)}, dim=${setting.dim}, lattice=${text(setting.lattice)},`,
        `             form=${text(setting.form)}, correction=${text(setting.correction)},`,
        `             dx_over_h=${text(setting["dx-over-h"])}, h_over_lambda=${text(setting["h-over-lambda"])},` +
          ` jitter=${text(setting.jitter)})`,
        "print(numbers(at))",
      ].join("\n"),
    ],
  ];
}
