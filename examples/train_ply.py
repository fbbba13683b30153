#!/usr/bin/env python3
"""Trains the Gaussians of a PLY file on pictures from the cameras of a JSON file. Needs torch and numpy.

  train_ply.py scene.ply cams.json --library build/release/lib/libsplatbus_torch.so --pictures views.npy --out out.ply

The JSON file has width, height, world_to_camera (4x4 each, camera axes x right, y down, z forward) and intrinsics
(3x3 each, pixels). The pictures are [cameras, height, width, 4] uint8 RGBA. Without any, the file's own renders are the
pictures, and the model starts disturbed: what training wins back is then known.
"""
import argparse
import json
import time

import numpy as np
import torch

CAMERAS_A_STEP = 4


def read_ply(path):
    """Parameters [channels, count] float32: mean, log scale, rotation wxyz, opacity logit, then SH by coefficient."""
    with open(path, 'rb') as file:
        names, count = [], 0
        for line in iter(file.readline, b'end_header\n'):
            words = line.split()
            if not words:
                raise ValueError(f'{path}: no end_header')
            if words[0] == b'format' and words[1] != b'binary_little_endian':
                raise ValueError(f'{path}: format {words[1].decode()}, binary_little_endian is needed')
            if words[0] == b'element':
                if words[1] != b'vertex':
                    raise ValueError(f'{path}: an element {words[1].decode()}, vertex alone is needed')
                count = int(words[2])
            elif words[0] == b'property':
                if words[1] not in (b'float', b'float32'):
                    raise ValueError(f'{path}: property {words[2].decode()} is {words[1].decode()}, not float')
                names.append(words[2].decode())
        table = np.frombuffer(file.read(), '<f4', count * len(names)).reshape(count, len(names))
    column = {name: table[:, i] for i, name in enumerate(names)}
    rest = sum(name.startswith('f_rest_') for name in names) // 3
    order = ['x', 'y', 'z', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3', 'opacity',
             'f_dc_0', 'f_dc_1', 'f_dc_2']
    # The file has all of red, then green, then blue.
    order += [f'f_rest_{color * rest + k}' for k in range(rest) for color in range(3)]
    return np.stack([column[name] for name in order])


def write_ply(path, parameters):
    rest = (len(parameters) - 14) // 3
    names = ['x', 'y', 'z', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3', 'opacity',
             'f_dc_0', 'f_dc_1', 'f_dc_2'] + [f'f_rest_{color * rest + k}' for k in range(rest) for color in range(3)]
    header = f'ply\nformat binary_little_endian 1.0\nelement vertex {parameters.shape[1]}\n'
    header += ''.join(f'property float {name}\n' for name in names) + 'end_header\n'
    with open(path, 'wb') as file:
        file.write(header.encode())
        file.write(np.ascontiguousarray(parameters.T, '<f4').tobytes())


def learning_rates(channels, extent_m):
    """One a channel, as in 3D Gaussian splatting (Kerbl et al. 2023)."""
    rates = [1.6e-4 * extent_m] * 3 + [5e-3] * 3 + [1e-3] * 4 + [5e-2] + [2.5e-3] * 3
    return rates + [2.5e-3 / 20] * (channels - len(rates))


class Views:
    """The cameras of a file, on the host, where the rasteriser reads them."""

    def __init__(self, path):
        with open(path) as file:
            cameras = json.load(file)
        self.width, self.height = cameras['width'], cameras['height']
        self.camera_from_world = torch.tensor(cameras['world_to_camera'], dtype=torch.float64)
        self.intrinsics = torch.tensor(cameras['intrinsics'], dtype=torch.float64)

    def __len__(self):
        return len(self.camera_from_world)

    def draw(self, parameters, which):
        """Color [len(which), 3, height, width] of those cameras, differentiable by the parameters."""
        color, _, _, _ = torch.ops.splatbus.rasterize(parameters, self.camera_from_world[which],
                                                      self.intrinsics[which], self.width, self.height)
        return color

    def draw_all(self, parameters):
        with torch.no_grad():
            groups = torch.arange(len(self)).split(CAMERAS_A_STEP)
            return torch.cat([self.draw(parameters, which) for which in groups]).clamp(0, 1)


def psnr(views, parameters, pictures):
    truth = pictures[..., :3].permute(0, 3, 1, 2).float() / 255
    return (-10 * torch.log10(((views.draw_all(parameters) - truth) ** 2).mean())).item()


def disturbed(parameters):
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(parameters.shape, generator=generator).to(parameters)
    sizes = torch.zeros(len(parameters), 1).to(parameters)
    sizes[3:6], sizes[10], sizes[11:14] = 0.2, 0.5, 0.3  # log scale, opacity logit, color
    return parameters + sizes * noise


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('ply')
    parser.add_argument('cameras')
    parser.add_argument('--library', dest='operators', required=True, help='libsplatbus_torch.so')
    parser.add_argument('--pictures', help='.npy file, [cameras, height, width, 4] uint8')
    parser.add_argument('--steps', type=int, default=500)
    parser.add_argument('--device', default='cuda' if torch.cuda.is_available() else 'cpu')
    parser.add_argument('--out', help='PLY file of the trained model')
    options = parser.parse_args()
    torch.ops.load_library(options.operators)

    views = Views(options.cameras)
    start = torch.from_numpy(read_ply(options.ply)).to(options.device)
    if options.pictures:
        pictures = torch.from_numpy(np.load(options.pictures)).to(options.device)
    else:
        color = (views.draw_all(start) * 255).round().to(torch.uint8)
        pictures = torch.cat([color, torch.full_like(color[:, :1], 255)], 1).permute(0, 2, 3, 1).contiguous()
        start = disturbed(start)

    parameters = start.clone().contiguous().requires_grad_()
    extent_m = (start[:3].std(1).norm() * 2).item()
    optimizer = torch.classes.splatbus.SparseAdam(parameters, learning_rates(len(parameters), extent_m))
    print(f'{parameters.shape[1]} Gaussians on {options.device}, {len(views)} cameras, '
          f'PSNR {psnr(views, parameters, pictures):.2f} dB')
    generator, began = torch.Generator().manual_seed(0), time.monotonic()
    for _ in range(options.steps):
        which = torch.randperm(len(views), generator=generator)[:CAMERAS_A_STEP]
        optimizer.zero_grad()
        color = views.draw(parameters, which)
        # A model of radiance is in display space already.
        loss = torch.ops.splatbus.image_loss(color, pictures[which.to(pictures.device)].contiguous(), encode_srgb=False)
        loss.mean().backward()
        optimizer.step()
    after = psnr(views, parameters, pictures)
    print(f'{options.steps} steps in {time.monotonic() - began:.1f} s, PSNR {after:.2f} dB')
    if options.out:
        write_ply(options.out, parameters.detach().cpu().numpy())


if __name__ == '__main__':
    main()
