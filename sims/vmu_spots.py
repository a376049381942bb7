"""Accuracy of the spot detector: error relative to the Cramer-Rao bound, covariance, detection, false spots.

python sims/vmu_spots.py [--images N] [--picture docs/pictures/vmu-spots.png]

Nine LEDs of a tilted target are at random sub-pixel positions of a small image, over ranges and noise levels. The
bound is that of a centre with all other parameters given, for the noise of the renderer; the errors include
the parameters that the detector estimates: background, flux, sharpness and shot noise.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hil.core.messages import Array
from hil.vmu.detect import SpotDetector
from hil.vmu.kernels.disc import add_disc
from hil.vmu.kernels.lens import LENS, CameraPair
from hil.vmu.render import Extras, Reflection, RingAppearance, RingRenderer, projections

SIZE, FOCAL, PATCH = 320, 1200.0, 57
GRID = np.stack(np.meshgrid([60.0, 160.0, 260.0], [60.0, 160.0, 260.0]), axis=-1).reshape(-1, 2)
RANGES_M = (0.4, 0.6, 0.9, 1.3, 2.0, 3.0, 6.0, 9.0, 12.0)
AWAY, STRAIGHT = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 0.0, 1.0])
PLAIN = RingAppearance()
LOOKS = {
    "plain": PLAIN,
    "sharp": replace(PLAIN, psf_sigma_px=0.7),
    "soft": replace(PLAIN, psf_sigma_px=1.6),
    "quiet": replace(PLAIN, read_noise_levels=0.4, electrons_per_level=400.0),
    "bright": replace(PLAIN, background_levels=60.0, gradient_levels=(40.0, -30.0), electrons_per_level=40.0),
    "noisy": replace(PLAIN, read_noise_levels=4.0, electrons_per_level=20.0),
    "noise 8": replace(PLAIN, read_noise_levels=8.0, background_levels=40.0),
    "clipped": replace(PLAIN, auto_peak_levels=500.0),
    "wide LED": replace(PLAIN, led_diameter_m=0.01),
}


@dataclass
class Row:
    """Result of many spots of one appearance at one range; ratio: RMS error over that of the bound."""

    found: float
    extra: int
    rmse_px: float
    ratio: float
    chi2: float
    within_2: float
    snr: float


def camera() -> CameraPair:
    lens = np.zeros(2, LENS)
    for name, value in (("fx", FOCAL), ("fy", FOCAL), ("cx", SIZE / 2), ("cy", SIZE / 2)):
        lens[name] = value
    lens["width"] = lens["height"] = SIZE
    return CameraPair(lens, np.stack([np.eye(3)] * 2), np.zeros((2, 3)))


def target(range_m: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return LEDs (9, 3) in t and the pose: tilted by up to 30 deg, each LED at a random phase of its pixel."""
    turn = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3))
    pixels = GRID + rng.uniform(-0.5, 0.5, GRID.shape)
    rays = np.column_stack([(pixels - SIZE / 2) / FOCAL, np.ones(len(pixels))])
    t_v = np.array([0.0, 0.0, range_m])
    return turn.inv().apply(rays * range_m - t_v), t_v, turn.inv().as_quat()


def bound(look: RingAppearance, spot: Array, flux: float) -> tuple[Array, float]:
    """Return the covariance (2, 2), px^2, of a centre's bound and the SNR of the flux."""
    corner = np.rint(spot[:2]) - PATCH // 2
    place, box, images = spot[:2] - corner, np.zeros(4, dtype=np.int64), []
    for du, dv in ((0.0, 0.0), (1e-3, 0.0), (-1e-3, 0.0), (0.0, 1e-3), (0.0, -1e-3)):
        images.append(np.zeros((PATCH, PATCH)))
        add_disc(images[-1], place[0] + du, place[1] + dv, spot[2], spot[3], spot[4], look.psf_sigma_px, flux, box)
    light = images[0]
    slope = np.array(look.gradient_levels) / SIZE
    level = look.background_levels + slope @ (spot[:2] - 0.5 * (SIZE - 1)) + light
    variance = look.read_noise_levels**2 + level / look.electrons_per_level + 1.0 / 12.0
    weight = np.where(level < 255.0, 1.0 / variance, 0.0)
    by_u, by_v = (images[1] - images[2]) / 2e-3, (images[3] - images[4]) / 2e-3
    information = np.array([[(weight * a * b).sum() for b in (by_u, by_v)] for a in (by_u, by_v)])
    return np.linalg.inv(information), float(np.sqrt((weight * light * light).sum()))


def study(look: RingAppearance, range_m: float, images: int, seed: int) -> Row:
    """Return the result of ``images`` images of nine LEDs at a range."""
    rng = np.random.default_rng(seed)
    pair, detector = camera(), SpotDetector((SIZE, SIZE))
    errors, expected, squares, snrs, found, extra, within = [], [], [], [], 0, 0, []
    for _ in range(images):
        leds, t_v, q_vt = target(range_m, rng)
        renderer = RingRenderer(pair, leds, look)
        image = renderer.image(0, t_v, q_vt, None, rng)
        spots = detector.spots(image)
        places = projections(pair, leds, t_v, q_vt)[0]
        discs, fluxes = renderer.led_images(0, t_v, q_vt)
        near = [int(np.argmin(np.hypot(places[:, 0] - s["u"], places[:, 1] - s["v"]))) for s in spots]
        for j, place in enumerate(places):
            own = [s for s, k in zip(spots, near, strict=True) if k == j]
            own = [s for s in own if np.hypot(place[0] - s["u"], place[1] - s["v"]) < 4.0]
            extra -= len(own)
            if not own:
                continue
            found += 1
            s = own[0]
            e = np.array([s["u"] - place[0], s["v"] - place[1]])
            covariance = np.array([[s["var_u"], s["cov_uv"]], [s["cov_uv"], s["var_v"]]])
            crb, snr = bound(look, discs[j], fluxes[j])
            errors.append(e)
            expected.append(np.diag(crb))
            squares.append(e @ np.linalg.solve(covariance, e))
            within += [abs(e[0]) < 2.0 * np.sqrt(s["var_u"]), abs(e[1]) < 2.0 * np.sqrt(s["var_v"])]
            snrs.append(snr)
        extra += len(spots)
    if not errors:
        return Row(0.0, extra, np.nan, np.nan, np.nan, np.nan, np.nan)
    e2, b2 = np.mean(np.square(errors)), np.mean(expected)
    return Row(
        found / (9 * images),
        extra,
        float(np.sqrt(e2)),
        float(np.sqrt(e2 / b2)),
        float(np.mean(squares) / 2.0),
        float(np.mean(within)),
        float(np.mean(snrs)),
    )


def faint(snr: float, images: int, seed: int, look: RingAppearance = PLAIN) -> tuple[float, float]:
    """Return the detected fraction of lights of ``snr`` (flux over sigma, given shape), and false spots per image."""
    rng = np.random.default_rng(seed)
    renderer, detector = RingRenderer(camera(), np.zeros((1, 3)), look), SpotDetector((SIZE, SIZE))
    variance = look.read_noise_levels**2 + look.background_levels / look.electrons_per_level + 1.0 / 12.0
    flux = snr * np.sqrt(4.0 * np.pi * variance * (look.psf_sigma_px**2 + 1.0 / 12.0))
    found = extra = 0
    for _ in range(images):
        places = GRID + rng.uniform(-20.0, 20.0, GRID.shape)
        lights = [Reflection(0, u, v, flux, look.psf_sigma_px) for u, v in places]
        image = renderer.image(0, AWAY, STRAIGHT, None, rng, Extras(reflections=lights))
        spots = detector.spots(image)
        centres = np.column_stack([spots["u"], spots["v"]])
        hits = sum(bool((np.hypot(*(centres - place).T) < 2.0).any()) for place in places)
        found += hits
        extra += len(spots) - hits
    return found / (len(GRID) * images), extra / images


def draw(rows: dict[str, list[Row]], shares: dict[float, tuple[float, float]], path: str) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4), constrained_layout=True)
    for colour, (name, found) in zip(("#0072b2", "#d55e00", "#009e73", "#cc79a7"), rows.items(), strict=False):
        left.loglog(RANGES_M, [r.rmse_px for r in found], "o", color=colour, label=name)
        left.loglog(RANGES_M, [r.rmse_px / r.ratio for r in found], "-", color=colour, linewidth=1)
        middle.semilogx(RANGES_M, [r.ratio for r in found], "o-", color=colour, label=name, linewidth=1)
        middle.semilogx(RANGES_M, [np.sqrt(r.chi2) for r in found], "x:", color=colour, linewidth=1)
    left.set(xlabel="range, m", ylabel="px", title="RMS error of a centre; line: Cramer-Rao bound")
    left.legend()
    middle.set(xlabel="range, m", ylim=(0.6, 1.8), title="o: error / bound, x: error / reported sigma")
    middle.axhline(1.0, color="0.6", linewidth=1)
    right.plot(list(shares), [share for share, _ in shares.values()], "o-", color="#0072b2", linewidth=1)
    right.set(xlabel="SNR of the flux", title="fraction of faint lights detected")
    figure.savefig(path, dpi=100)
    print(path)


def main(images: int, only: str | None, picture: str | None) -> None:
    print(
        f"{'look':9} {'range':>6} {'SNR':>6} {'found':>6} {'extra':>5} "
        f"{'RMSE px':>8} {'/CRB':>6} {'chi2':>6} {'<2s':>6}"
    )
    rows: dict[str, list[Row]] = {}
    for name, look in LOOKS.items():
        if only and only != name:
            continue
        for range_m in RANGES_M:
            r = study(look, range_m, images, 1)
            rows.setdefault(name, []).append(r)
            print(
                f"{name:9} {range_m:6.1f} {r.snr:6.0f} {r.found:6.3f} {r.extra:5d} {r.rmse_px:8.4f} {r.ratio:6.3f}"
                f" {r.chi2:6.3f} {r.within_2:6.3f}",
                flush=True,
            )
    shares = {snr: faint(snr, images, 2) for snr in (4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0)}
    for snr, (share, extra) in shares.items():
        print(f"SNR {snr:4.0f}: found {share:5.3f}, false spots an image of {SIZE} x {SIZE}: {extra:.3f}")
    if picture:
        draw({name: rows[name] for name in ("plain", "sharp", "bright", "noisy") if name in rows}, shares, picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=30)
    parser.add_argument("--look", choices=LOOKS, help="only this appearance")
    parser.add_argument("--picture")
    given = parser.parse_args()
    main(given.images, given.look, given.picture)
