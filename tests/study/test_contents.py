"""inspect: the kernel and the meaning of h that made the densities of a file, and what else it has.

Densities are summed here pair by pair with the formulas of the papers; nothing of the package is
used for it.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from sphtrunc.cli import main
from sphtrunc.study.snapshots.contents import inspect
from sphtrunc.study.snapshots.saved_sums import named_otherwise
from tests.scenes import written

PI = np.pi


def cubic(u):
    """M4 on the support 1 (Springel 2005, eq. 4)."""
    return 8 / PI * np.where(u < 0.5, 1 - 6 * u**2 + 6 * u**3, 2 * np.clip(1 - u, 0, None) ** 3)


def quintic(u):
    """M6 on the support 1 (Dehnen & Aly 2012, table 1)."""
    p = [np.clip(a - u, 0, None) ** 5 for a in (1, 2 / 3, 1 / 3)]
    return 3**7 / (40 * PI) * (p[0] - 6 * p[1] + 15 * p[2])


def wendland_c2(u):
    """On the support 1 (Dehnen & Aly 2012, table 1)."""
    return 21 / (2 * PI) * np.clip(1 - u, 0, None) ** 4 * (1 + 4 * u)


def wendland_c6(u):
    """On the support 1 (Dehnen & Aly 2012, table 1)."""
    return 1365 / (64 * PI) * np.clip(1 - u, 0, None) ** 8 * (1 + 8 * u + 25 * u**2 + 32 * u**3)


def lucy(u):
    return 105 / (16 * PI) * (1 + 3 * u) * np.clip(1 - u, 0, None) ** 3


def quartic_power(u):
    """(1 − u²)⁴, the density kernel of LAMMPS' sph/rhosum."""
    return 3465 / (512 * PI) * np.clip(1 - u**2, 0, None) ** 4


#: support over 2σ (Dehnen & Aly 2012, table 1)
TWO_SIGMA = {"cubic-spline": 1.825742, "wendland-c2": 1.936492, "wendland-c6": 2.449490}


def differences(c, period=None):
    d = c.x[:, None] - c.x[None]
    return d if period is None else d - period * np.round(d / period)


def summed(c, kernel, ratio, mode="gather", periodic=True):
    """c with the densities that a code sums with a kernel on the support ratio·h."""
    r = np.sqrt((differences(c, c.box if periodic else None) ** 2).sum(axis=2))
    pair = {
        "gather": c.h[:, None] + 0 * r,
        "scatter": c.h[None] + 0 * r,
        "mean": 0.5 * (c.h[:, None] + c.h[None]),
    }[mode]
    H = ratio * pair
    return replace(c, rho=(c.m[None] * kernel(r / H) / H**3).sum(axis=1))


CLOUD = written.cloud(side=8, seed=2, jitter=0.2)
SMALL = replace(CLOUD, h=CLOUD.h * 1.02)

CASES = [
    ("cubic-spline", cubic, 2.0),
    ("cubic-spline", cubic, 1.825742),
    ("cubic-spline", cubic, 1.0),
    ("quintic-spline", quintic, 3.0),
    ("wendland-c2", wendland_c2, 2.0),
    ("wendland-c2", wendland_c2, 1.936492),
    ("wendland-c6", wendland_c6, 2.0),
    ("lucy", lucy, 2.0),
    ("polynomial:3", quartic_power, 2.0),
]


@pytest.mark.parametrize(("name", "kernel", "ratio"), CASES)
def test_the_kernel_and_the_meaning_of_h_are_named(name, kernel, ratio, tmp_path):
    wide = 2.0 if ratio == 1.0 else 1.0  # h is the support: as many neighbours as otherwise
    c = replace(SMALL, h=SMALL.h * wide)
    if ratio not in (1.0, 2.0, 3.0):
        ratio = exact_ratio(name)
    written.npz(tmp_path / "a.npz", summed(c, kernel, ratio))
    found = inspect(tmp_path / "a.npz", period=1.0)
    best = found.identified.best
    assert found.identified.fits
    assert best.kernel == name
    assert best.support_over_h == pytest.approx(ratio, rel=1e-12)
    assert best.residual < 1e-12
    assert found.identified.next.residual > 1e-4


def exact_ratio(name):
    """κ/(2σ) from moments that are integrated here."""
    kernel = {"cubic-spline": cubic, "wendland-c2": wendland_c2}[name]
    u, w = np.polynomial.legendre.leggauss(60)
    second = 0.0
    for low, high in ((0.0, 0.5), (0.5, 1.0)):
        at = 0.5 * (high - low) * u + 0.5 * (high + low)
        second += 0.5 * (high - low) * (w * 4 * PI * at**4 * kernel(at)).sum()
    ratio = 1 / (2 * np.sqrt(second / 3))
    assert ratio == pytest.approx(TWO_SIGMA[name], abs=1e-6)
    return ratio


@pytest.mark.parametrize("mode", ["mean", "scatter"])
def test_whose_h_a_pair_takes_is_said(mode, tmp_path):
    written.npz(tmp_path / "a.npz", summed(SMALL, cubic, 2.0, mode))
    best = inspect(tmp_path / "a.npz", period=1.0).identified.best
    assert (best.kernel, best.support_over_h, best.mode) == ("cubic-spline", 2.0, mode)
    assert best.residual < 1e-12


@pytest.mark.parametrize("name", ["swift", "gadget", "sph-exa", "vtp-ascii", "lammps", "bi4"])
def test_formats_in_single_and_double_precision(name, tmp_path):
    c = replace(SMALL, h=np.full(SMALL.n, SMALL.h[0]))
    c = summed(c.single() if name in ("gadget", "bi4") else c, cubic, 2.0, periodic=name != "bi4")
    path, _ = written.write(tmp_path, name, c)
    found = inspect(path, period="none" if name == "bi4" else 1.0, h=float(c.h[0]))
    assert found.identified.fits
    assert found.identified.best.kernel == "cubic-spline"
    assert found.identified.best.residual < 2e-7


def test_phantom_sums_what_its_h_says(tmp_path):
    """ρ = m (hfact/h)³ is not saved; h is iterated until it is the sum."""
    c = SMALL
    r = np.sqrt((differences(c, c.box) ** 2).sum(axis=2))
    for _ in range(60):
        H = 2.0 * c.h[:, None]
        rho = (c.m * cubic(r / H) / H**3).sum(axis=1)
        c = replace(c, h=1.2 * (c.m / rho) ** (1 / 3))
    written.phantom(tmp_path / "p.h5", c)
    found = inspect(tmp_path / "p.h5")
    assert found.identified.fits
    assert found.identified.best.support_over_h == 2.0
    assert found.h_over_dx["median"] == pytest.approx(1.2, rel=1e-12)


# ------------------------------------------------------------------------- what cannot be named


def test_a_header_that_names_another_kernel_is_contradicted(tmp_path):
    c = summed(SMALL, wendland_c2, 2.0)
    written.swift(tmp_path / "a.hdf5", c)
    text = inspect(tmp_path / "a.hdf5").to_text()
    assert "names 'Cubic spline (M4)': the densities say otherwise" in text
    written.swift(tmp_path / "b.hdf5", summed(SMALL, cubic, 2.0))
    assert "names 'Cubic spline (M4)': as found" in inspect(tmp_path / "b.hdf5").to_text()
    assert not named_otherwise("some kernel of ours", ["lucy"])


def test_evolved_densities_fit_no_kernel(tmp_path):
    rng = np.random.default_rng(1)
    c = summed(SMALL, cubic, 2.0)
    written.npz(tmp_path / "a.npz", replace(c, rho=c.rho * (1 + 1e-3 * rng.normal(size=c.n))))
    found = inspect(tmp_path / "a.npz", period=1.0)
    assert not found.identified.fits
    assert found.to_dict()["identified"] is None
    assert "no kernel gives the densities" in found.why["kernel"]


def test_on_a_lattice_several_kernels_fit(tmp_path):
    """Wide kernels of a uniform lattice all give m/Δx³."""
    c = written.cloud(side=16, jitter=0.0)
    c = replace(c, h=np.full(c.n, 4 / 16), rho=np.ones(c.n))
    written.npz(tmp_path / "a.npz", c)
    found = inspect(tmp_path / "a.npz", period=1.0)
    assert not found.identified.fits
    assert "several kernels give the densities" in found.why["kernel"]


def test_masses_that_are_not_saved_are_equal(tmp_path):
    c = summed(SMALL, quintic, 3.0)
    np.savez(tmp_path / "a.npz", x=c.x, h=c.h, rho=7.0 * c.rho)
    found = inspect(tmp_path / "a.npz", period=1.0)
    assert found.identified.best.kernel == "quintic-spline"
    assert found.identified.best.residual < 1e-12
    assert "taken as equal" in found.why["kernel"]


def test_what_is_missing_is_said(tmp_path):
    np.savez(tmp_path / "a.npz", x=CLOUD.x)
    assert "no smoothing length; --h H" in inspect(tmp_path / "a.npz").why["kernel"]
    np.savez(tmp_path / "b.npz", x=CLOUD.x, h=0.2)
    assert "the file has no density" in inspect(tmp_path / "b.npz").why["kernel"]
    np.savez(tmp_path / "c.npz", x=np.zeros((1, 3)), h=0.2)
    with pytest.raises(ValueError, match="one particle"):
        inspect(tmp_path / "c.npz")


# -------------------------------------------------------------------------------- accelerations


def forces(c, slope, ratio, pressure):
    """−Σ m_b (P_a/ρ_a² + P_b/ρ_b²) ∇W for one h; slope: dW/du on the support 1."""
    d = differences(c, c.box)
    r = np.sqrt((d**2).sum(axis=2))
    H = ratio * c.h[0]
    np.fill_diagonal(r, 1.0)
    g = pressure / c.rho**2
    pair = c.m[None] * (g[:, None] + g[None]) * slope(r / H) / H**4 / r
    np.fill_diagonal(pair, 0.0)
    return -(pair[:, :, None] * d).sum(axis=1)


def lucy_slope(u):
    return 105 / (16 * PI) * -12 * u * np.clip(1 - u, 0, None) ** 2


@pytest.mark.parametrize("saved", [True, False])
def test_density_and_force_kernels_are_told_apart(saved, tmp_path):
    """As LAMMPS' SPH package: density from (1 − u²)⁴, forces from Lucy's gradient."""
    c = replace(SMALL, h=np.full(SMALL.n, 2.2 * SMALL.h[0]))
    c = summed(c, quartic_power, 1.0)
    pressure = 7.0 * ((c.rho / c.rho.mean()) ** 7 - 1.0) + 0.5
    a = forces(c, lucy_slope, 1.0, pressure)
    more = {"pressure": pressure} if saved else {}
    np.savez(tmp_path / "a.npz", x=c.x, h=c.h, m=c.m, rho=c.rho, acceleration=a, **more)
    found = inspect(tmp_path / "a.npz", period=1.0)
    assert found.identified.best.kernel == "polynomial:3"
    assert found.identified.best.support_over_h == 1.0
    assert found.forces.fits
    assert found.forces.best.kernel == "lucy"
    assert found.forces.best.support_over_h == 1.0
    assert found.forces.next.residual > 10 * found.forces.best.residual
    assert (
        "W of the densities is polynomial:3, W′ of the accelerations is that of lucy"
        in (found.why["operators"])
    )


def test_accelerations_of_something_else_fit_no_kernel(tmp_path):
    c = summed(replace(SMALL, h=np.full(SMALL.n, SMALL.h[0])), cubic, 2.0)
    np.savez(tmp_path / "a.npz", x=c.x, h=c.h, m=c.m, rho=c.rho, acceleration=c.v)
    found = inspect(tmp_path / "a.npz", period=1.0)
    assert not found.forces.fits
    assert "more in them than pressure" in found.why["gradient"]
    assert found.to_dict()["gradient"] is None


# ------------------------------------------------------------------------------ pairs and counts


def test_pairs_and_coincidences_are_counted(tmp_path):
    c = written.cloud(side=6, jitter=0.02)
    close = c.x[[3, 50, 100]] + [0.3 / 6, 0, 0]
    np.savez(tmp_path / "a.npz", x=np.concatenate([c.x, close, c.x[[7]]]), h=0.2)
    found = inspect(tmp_path / "a.npz")
    assert (found.spacing.close, found.spacing.coincident, found.spacing.first) == (
        3,
        1,
        (7, c.n + 3),
    )
    r = np.sqrt((differences(c) ** 2).sum(axis=2)) + 9 * np.eye(c.n)
    assert found.spacing.median == pytest.approx(np.median(r.min(axis=1)), rel=0.02)
    assert found.spacing.least == pytest.approx(0.05, rel=1e-9)


def test_neighbours_are_counted_in_the_support_that_was_found(tmp_path):
    c = summed(SMALL, cubic, 2.0)
    written.npz(tmp_path / "a.npz", c)
    found = inspect(tmp_path / "a.npz", period=1.0)
    r = np.sqrt((differences(c, 1.0) ** 2).sum(axis=2))
    inside = (r <= 2.0 * c.h[:, None]).sum(axis=1)
    assert found.neighbours["support_over_h"] == 2.0
    assert found.neighbours["median"] == np.median(inside)
    assert found.neighbours["max"] == inside.max()


# ------------------------------------------------------------------------------ the command line


def test_the_json_is_a_contract(tmp_path, capsys):
    c = summed(SMALL, cubic, 2.0)
    written.swift(tmp_path / "a.hdf5", c)
    with pytest.raises(SystemExit) as stop:
        main(["inspect", str(tmp_path / "a.hdf5"), "--format", "json"])
    assert stop.value.code == 0
    told = json.loads(capsys.readouterr().out)
    assert told["schema"] == "sphtrunc.inspect/1"
    assert (told["format"], told["code"], told["dim"]) == ("gadget", "SWIFT 0.9.0", 3)
    assert told["particles"] == {"0": c.n, "1": 7}
    assert told["box"]["size"] == [1, 1, 1]
    assert told["fields"]["density"] == {"min": c.rho.min(), "max": c.rho.max()}
    assert set(told["spacing"]) == {"min", "median"}
    r = np.sqrt((differences(c, c.box) ** 2).sum(axis=2)) + 9 * np.eye(c.n)
    assert told["pairs_close"] == (r < 0.5 * np.median(r.min(axis=1))).sum() // 2 > 0
    assert told["duplicates"] == 0
    assert set(told["identified"]) >= {"kernel", "support_over_h", "residual", "next"}
    assert set(told["identified"]["next"]) >= {"kernel", "support_over_h", "residual"}
    assert told["identified"]["kernel"] == "cubic-spline"
    assert told["agrees"] is True


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["none.hdf5"], "there is no such file"),
        (["a.csv", "--dim", "3"], "they are in 2D"),
        (["a.csv", "--columns", "h=size"], "no such column; there are x, y, h"),
        (["a.csv", "--columns", "h"], "expected quantity=NAME"),
        (["a.csv", "--type", "4"], "a table has one type"),
        (["a.csv", "--period", "1,2,3"], "expected one length or 2"),
        (["a.csv", "--h", "-1"], "h: got -1, expected a positive number"),
    ],
)
def test_a_wrong_option_is_one_line(options, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rows = "\n".join(f"{i / 7},{(i % 3) / 3},0.4" for i in range(9))
    (tmp_path / "a.csv").write_text(f"x,y,h\n{rows}\n", encoding="utf-8")
    with pytest.raises(SystemExit) as stop:
        main(["inspect", *options])
    streams = capsys.readouterr()
    assert stop.value.code == 2
    assert message in streams.err
    assert streams.err.count("\n") == 1
    assert not streams.out


def test_a_period_with_open_axes(tmp_path, capsys):
    np.savez(tmp_path / "a.npz", x=CLOUD.x, h=0.1)
    with pytest.raises(SystemExit):
        main(["inspect", str(tmp_path / "a.npz"), "--period", "1,1,inf"])
    assert "periodic along x, y" in capsys.readouterr().out
