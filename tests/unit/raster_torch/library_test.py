"""The operations as Python sees them. CTest takes exit status 77 for skipped."""
import importlib.util
import json
import math
import os
import subprocess
import sys
import tempfile
import unittest

LIBRARY = os.environ['SPLATBUS_TORCH_LIBRARY']
EXAMPLE = os.path.join(os.environ['SPLATBUS_SOURCE_DIR'], 'examples', 'train_ply.py')


def skip(why):
    print('skipped:', why)
    sys.exit(77)


try:
    import numpy as np
    import torch
except ImportError as error:
    skip(f'{sys.executable}: {error}')
with open('/proc/self/maps') as maps:
    LOADED = {os.path.realpath(line.split()[-1]) for line in maps if 'libtorch_cpu' in line}
BUILT_AGAINST = os.path.dirname(os.path.realpath(os.environ['SPLATBUS_LIBTORCH']))
if BUILT_AGAINST not in {os.path.dirname(path) for path in LOADED}:
    skip(f'torch of {sys.executable} is {torch.__file__}, the library is built against {BUILT_AGAINST}')
torch.ops.load_library(LIBRARY)

SH_C0 = 0.28209479177387814
WIDTH, HEIGHT, FOCAL = 33, 25, 40.0
DEVICES = ['cpu'] + (['cuda'] if os.environ['SPLATBUS_TORCH_HAS_CUDA'] == '1' and torch.cuda.is_available() else [])


def gaussian(mean, scale=0.05, opacity=0.8, dc=(0.5, -0.3, 1.0)):
    """One channel a row, degree 0, round."""
    logit = math.log(opacity / (1 - opacity))
    return torch.tensor([*mean, *[math.log(scale)] * 3, 1, 0, 0, 0, logit, *dc]).reshape(14, 1)


def camera(x=0.0):
    """At (x, 0, 0), looking along z, the principal point at the middle of a pixel."""
    pose = torch.eye(4)
    pose[0, 3] = -x
    lens = torch.tensor([[FOCAL, 0, 16.5], [0, FOCAL, 12.5], [0, 0, 1]])
    return pose, lens


def draw(parameters, eyes=(0.0,), **options):
    poses, lenses = zip(*(camera(x) for x in eyes))
    return torch.ops.splatbus.rasterize(parameters, torch.stack(poses), torch.stack(lenses), WIDTH, HEIGHT, **options)


class Rasterize(unittest.TestCase):
    def test_one_gaussian_on_the_axis_by_hand(self):
        for device in DEVICES:
            model = gaussian((0, 0, 2.0)).to(device)
            color, alpha, albedo, depth = draw(model, background=[1.0, 1.0, 1.0], antialias=False, depth=True)
            self.assertEqual(list(color.shape), [1, 3, HEIGHT, WIDTH])
            self.assertIsNone(albedo)
            self.assertAlmostEqual(alpha[0, 12, 16].item(), 0.8, places=5)
            self.assertAlmostEqual(depth[0, 12, 16].item(), 1.6, places=5)
            for k, dc in enumerate((0.5, -0.3, 1.0)):
                self.assertAlmostEqual(color[0, k, 12, 16].item(), 0.8 * (0.5 + SH_C0 * dc) + 0.2, places=5)
            # Five pixels to the right, variance (scale f / z)^2 + blur.
            variance = (0.05 * FOCAL / 2) ** 2 + 0.3
            self.assertAlmostEqual(alpha[0, 12, 18].item(), 0.8 * math.exp(-0.5 * 4 / variance), places=4)

    def test_a_camera_to_the_right_sees_it_to_the_left(self):
        _, alpha, _, _ = draw(gaussian((0, 0, 2.0)), eyes=(0.0, 0.25))
        peaks = [divmod(picture.argmax().item(), WIDTH) for picture in alpha]
        self.assertEqual(peaks, [(12, 16), (12, 11)])  # 0.25 m * 40 px / 2 m = 5 px

    def test_gradient_by_finite_differences(self):
        model = torch.cat([gaussian((0.02, 0.01, 2.0), 0.1), gaussian((-0.05, 0.1, 2.5), 0.2)], 1)
        generator = torch.Generator().manual_seed(1)
        # In the middle, where no pixel crosses the threshold under which a Gaussian is skipped.
        weights = torch.zeros(2, 3, HEIGHT, WIDTH)
        weights[:, :, 10:15, 13:19] = torch.rand(2, 3, 5, 6, generator=generator)

        def value(parameters):
            return (draw(parameters, eyes=(0.0, 0.1))[0] * weights.to(parameters.device)).sum()

        for device in DEVICES:
            parameters = model.detach().clone().to(device).requires_grad_()
            value(parameters).backward()
            for channel in (0, 1, 2, 3, 10, 12):
                step = torch.zeros_like(model)
                step[channel, 0] = 1e-3
                with torch.no_grad():
                    slope = (value((model + step).to(device)) - value((model - step).to(device))).item() / 2e-3
                self.assertAlmostEqual(parameters.grad[channel, 0].item(), slope, delta=0.01 * abs(slope) + 0.02)

    def test_light_reaches_a_transfer_model(self):
        model = torch.zeros(41, 1)
        model[:14] = gaussian((0, 0, 2.0))
        model[11:14] = torch.tensor([0.2, 0.4, 0.6]).reshape(3, 1)  # albedo
        color = draw(model, normal=torch.tensor([[0.0], [0], [-1]]), sun_direction=[0.0, 0.6, -0.8],
                     sun_irradiance=[math.pi] * 3, antialias=False)[0]
        for k, albedo in enumerate((0.2, 0.4, 0.6)):
            self.assertAlmostEqual(color[0, k, 12, 16].item(), 0.8 * albedo * 0.8, places=5)

    def test_objects_move(self):
        pose = torch.eye(4)
        pose[0, 3] = 0.25
        alpha = draw(gaussian((0, 0, 2.0)), object_id=torch.tensor([7], dtype=torch.int32), objects=[7],
                     world_from_object=pose[None])[1]
        self.assertEqual(divmod(alpha[0].argmax().item(), WIDTH), (12, 21))

    def test_objects_have_a_scale(self):
        pose = torch.eye(4)
        pose[:3, :3] *= 2
        alpha = draw(gaussian((0.1, 0, 1.0)), object_id=torch.tensor([7], dtype=torch.int32), objects=[7],
                     world_from_object=pose[None])[1]
        by_hand = gaussian((0.2, 0, 2.0))
        by_hand[3:6] += math.log(2)
        self.assertTrue(torch.allclose(alpha, draw(by_hand)[1], atol=1e-5))

    def test_statistics_are_added_to(self):
        model = gaussian((0, 0, 2.0)).requires_grad_()
        visible, contribution = torch.zeros(1, dtype=torch.uint8), torch.zeros(1)
        draw(model, visible=visible, contribution=contribution, antialias=False)[0].sum().backward()
        self.assertEqual(visible.item(), 1)
        self.assertAlmostEqual(contribution.item(), 0.8, places=5)

    def test_what_does_not_fit_is_named(self):
        model, (pose, lens) = gaussian((0, 0, 2.0)), camera()
        skewed = pose.clone()
        skewed[0, 1] = 0.5
        for said, arguments in (('14, 23, 38 or 59', (model[:13].contiguous(), pose[None], lens[None], 8, 8)),
                                ('is not a rotation', (model, skewed[None], lens[None], 8, 8)),
                                ('camera_from_world is', (model, pose, lens[None], 8, 8)),
                                ('a side has 1 to', (model, pose[None], lens[None], 0, 8)),
                                ('is not contiguous', (model.expand(14, 2), pose[None], lens[None], 8, 8))):
            with self.assertRaisesRegex(RuntimeError, said):
                torch.ops.splatbus.rasterize(*arguments)

    def test_an_error_is_its_message_and_nothing_else(self):
        # The variable makes PyTorch append the frames that an error was thrown from, which is for its own operations.
        code = ('import sys, torch\ntorch.ops.load_library(sys.argv[1])\n'
                'for call in (lambda: torch.ops.splatbus.image_loss(torch.zeros(3), torch.zeros(3)),\n'
                '             lambda: torch.classes.splatbus.SparseAdam(torch.zeros(3), [0.1])):\n'
                '    try:\n        call()\n    except RuntimeError as error:\n        print(str(error).strip())\n')
        run = subprocess.run([sys.executable, '-c', code, LIBRARY], capture_output=True, text=True, check=False,
                             env={**os.environ, 'TORCH_SHOW_CPP_STACKTRACES': '1'})
        self.assertEqual(run.returncode, 0, run.stderr)
        self.assertEqual(run.stdout.splitlines(), ['image_loss: rendered is not [pictures, 3, height, width]',
                                                   'SparseAdam: parameters is not [channels, count]'])


class Training(unittest.TestCase):
    def test_loss_of_equal_pictures_is_zero(self):
        picture = torch.full((1, 3, 16, 16), 128 / 255)
        target = torch.full((1, 16, 16, 4), 128, dtype=torch.uint8)
        loss = torch.ops.splatbus.image_loss(picture, target, encode_srgb=False)
        self.assertAlmostEqual(loss.item(), 0, places=5)
        half = torch.ops.splatbus.image_loss(picture * 0.5, target, ssim_weight=0.0, encode_srgb=False)
        self.assertAlmostEqual(half.item(), 64 / 255, places=5)

    def test_first_step_of_adam_is_the_rate(self):
        for device in DEVICES:
            parameters = gaussian((0, 0, 2.0)).to(device).requires_grad_()
            before = parameters.detach().clone()
            adam = torch.classes.splatbus.SparseAdam(parameters, [0.01] * 14)
            parameters.grad = torch.full_like(before, -3.0)
            adam.step()
            self.assertTrue(torch.allclose(parameters.detach(), before + 0.01, atol=1e-5))

    def test_the_example_wins_back_what_was_disturbed(self):
        spec = importlib.util.spec_from_file_location('train_ply', EXAMPLE)
        example = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(example)
        random = np.random.default_rng(3)
        count = 300
        model = np.zeros((23, count), np.float32)
        model[:3] = random.uniform(-0.5, 0.5, (3, count)) + np.array([[0], [0], [2]])
        model[3:6], model[6], model[10], model[11:] = math.log(0.06), 1, 1.5, random.normal(0, 0.5, (12, count))
        poses, lenses = zip(*(camera(x) for x in (-0.3, -0.1, 0.1, 0.3)))
        with tempfile.TemporaryDirectory() as folder:
            ply, cameras, out = (os.path.join(folder, name) for name in ('in.ply', 'cams.json', 'out.ply'))
            example.write_ply(ply, model)
            self.assertTrue(np.array_equal(example.read_ply(ply), model))
            with open(cameras, 'w') as file:
                json.dump({'width': WIDTH, 'height': HEIGHT, 'world_to_camera': torch.stack(poses).tolist(),
                           'intrinsics': torch.stack(lenses).tolist()}, file)
            for device in DEVICES:
                run = subprocess.run([sys.executable, EXAMPLE, ply, cameras, '--library', LIBRARY, '--steps', '150',
                                      '--device', device, '--out', out], capture_output=True, text=True, check=False)
                self.assertEqual(run.returncode, 0, run.stderr)
                before, after = (float(line.split('PSNR ')[1].split()[0]) for line in run.stdout.splitlines())
                self.assertGreater(after, before + 6, run.stdout)
                self.assertEqual(example.read_ply(out).shape, model.shape)


if __name__ == '__main__':
    unittest.main(verbosity=2)
