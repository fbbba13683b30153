#!/usr/bin/env python3
"""Prints the expected values that metrics_test.cpp embeds.

The pictures are those of pictures.h, made here a second time. PSNR and SSIM are scikit-image's; FLIP is a plain
transcription of Andersson et al. 2020 with two-dimensional filters, in double precision. Needs python3-numpy,
python3-scipy and python3-skimage; with --raw DIR it also writes the pictures as interleaved 8-bit RGB files, for other
implementations.
"""
import argparse
import pathlib

import numpy as np
from scipy import ndimage
from skimage import metrics

WIDTH, HEIGHT = 96, 72


def hash32(x, y, c):
    """A picture's worth of pseudo-random 32-bit numbers, as hash32() of pictures.h."""
    h = (x * 374761393 + y * 668265263 + c * 2246822519 + 3266489917) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 3266489917) & 0xFFFFFFFF
    return h ^ (h >> 16)


def reference():
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.int64)
    out = np.stack([(x * 255) // (WIDTH - 1), (y * 255) // (HEIGHT - 1), ((x + y) * 3) % 256], axis=-1)
    checker = (x // 6 + y // 6) % 2 == 1
    out[checker] = out[checker] * 3 // 4
    disc = (x - 60) ** 2 + (y - 30) ** 2 < 18 * 18
    out[disc] = [200, 60, 40]
    line = (x - y == 10) | (y == 50)
    out[line] = [250, 250, 240]
    return out


def variants(ref):
    y, x, c = np.mgrid[0:HEIGHT, 0:WIDTH, 0:3].astype(np.int64)
    noise = np.clip(ref + hash32(x, y, c) % 49 - 24, 0, 255)
    shifted = ref[:, np.maximum(np.arange(WIDTH) - 2, 0)]
    padded = np.pad(ref, ((1, 1), (1, 1), (0, 0)), mode="edge")
    blurred = sum(padded[dy:dy + HEIGHT, dx:dx + WIDTH] for dy in range(3) for dx in range(3)) // 9
    tinted = np.clip(ref * np.array([10, 7, 8]) // 8 + np.array([0, 6, -9]), 0, 255)
    return {"noise": noise, "shift": shifted, "blur": blurred, "tint": tinted}


XYZ_FROM_RGB = np.array([[10135552, 8788810, 4435075],
                         [5226144, 17577620, 1774030],
                         [475104, 8788810 / 3, 70074185 / 3]])
XYZ_FROM_RGB /= 24577794
WHITE = XYZ_FROM_RGB.sum(axis=1)


def opponent(v):
    x, y, z = np.moveaxis(v, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def hunt_lab(rgb):
    t = rgb @ XYZ_FROM_RGB.T / WHITE
    delta = 6 / 29
    lab = opponent(np.where(t > delta**3, np.cbrt(t), t / (3 * delta**2) + 4 / 29))
    lab[..., 1:] *= 0.01 * lab[..., :1]
    return lab


def hyab(a, b):
    d = a - b
    return np.abs(d[..., 0]) + np.hypot(d[..., 1], d[..., 2])


def filter_image(plane, kernel):
    return ndimage.correlate(plane, kernel, mode="nearest")


def flip(test, ref, ppd=67.0):
    def to_opponent(image):
        s = image / 255.0
        linear = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
        return opponent(linear @ XYZ_FROM_RGB.T / WHITE)

    radius = int(np.ceil(3 * np.sqrt(0.04 / (2 * np.pi**2)) * ppd))
    y, x = np.mgrid[-radius:radius + 1, -radius:radius + 1] / ppd

    def csf(a1, b1, a2, b2):
        d2 = x**2 + y**2
        g = sum(a * np.sqrt(np.pi / b) * np.exp(-np.pi**2 * d2 / b) for a, b in ((a1, b1), (a2, b2)))
        return g / g.sum()

    kernels = csf(1, 0.0047, 0, 1e-5), csf(1, 0.0053, 0, 1e-5), csf(34.1, 0.04, 13.5, 0.025)

    def perceived(image):
        f = np.stack([filter_image(image[..., i], kernels[i]) for i in range(3)], axis=-1)
        fy = (f[..., 0] + 16) / 116
        xyz = np.stack([fy + f[..., 1] / 500, fy, fy - f[..., 2] / 200], axis=-1) * WHITE
        return hunt_lab(np.clip(xyz @ np.linalg.inv(XYZ_FROM_RGB).T, 0, 1))

    a, b = to_opponent(test), to_opponent(ref)
    difference = hyab(perceived(a), perceived(b)) ** 0.7
    largest = hyab(hunt_lab(np.array([0.0, 1, 0])), hunt_lab(np.array([0.0, 0, 1]))) ** 0.7
    cut = 0.4 * largest
    color = np.where(difference < cut, 0.95 / cut * difference,
                     0.95 + (difference - cut) / (largest - cut) * 0.05)

    sigma = 0.5 * 0.082 * ppd
    radius = int(np.ceil(3 * sigma))
    y, x = np.mgrid[-radius:radius + 1, -radius:radius + 1].astype(float)
    g = np.exp(-(x**2 + y**2) / (2 * sigma**2))

    def balanced(k):
        return np.where(k < 0, k / -k[k < 0].sum(), k / k[k > 0].sum())

    def strength(image, kernel):
        gray = (image[..., 0] + 16) / 116
        return np.hypot(filter_image(gray, kernel), filter_image(gray, kernel.T))

    edge, point = balanced(-x * g), balanced((x**2 / sigma**2 - 1) * g)
    feature = np.maximum(np.abs(strength(a, edge) - strength(b, edge)), np.abs(strength(a, point) - strength(b, point)))
    return color ** (1 - np.sqrt(feature / np.sqrt(2)))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--raw", type=pathlib.Path)
    args = parser.parse_args()
    ref = reference()
    for name, test in variants(ref).items():
        a, b = test.astype(np.uint8), ref.astype(np.uint8)
        ssim, ssim_map = metrics.structural_similarity(b, a, gaussian_weights=True, sigma=1.5,
                                                       use_sample_covariance=False, data_range=255, channel_axis=2,
                                                       full=True)
        psnr = metrics.peak_signal_noise_ratio(b, a, data_range=255)
        maps = [flip(test, ref), flip(test, ref, 30.0)]
        print(f'{{"{name}", {psnr:.6f}, {ssim:.6f}, {ssim_map.mean():.6f}, {maps[0].mean():.6f}, {maps[1].mean():.6f}, '
              f'{maps[0][30, 60]:.6f}, {maps[0][0, 0]:.6f}}},')
        if args.raw:
            a.tofile(args.raw / f"{name}.rgb")
    if args.raw:
        ref.astype(np.uint8).tofile(args.raw / "reference.rgb")


if __name__ == "__main__":
    main()
