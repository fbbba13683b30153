#!/usr/bin/env python3
"""What engines that share the cameras of one world gain: pictures a second, and the model's SSIM, with one and with two.

The toys move under a turning sun. Each engine is held to its frame rate and one picture a frame (--pictures-s 0), as an
engine that plays a game beside is, so that the engine limits and not this machine's processor. All pictures are
asked for again as soon as the scene is another. SSIM is of a viewer's pictures against the engine's own of the instant.
usage: bench/engine_replicas.py [--splatbus build/release/bin/splatbus] [--fps 8] [--train 60] [--seconds 30]
"""
import argparse
import json
import os
import pathlib
import statistics
import subprocess
import tempfile
import time

LAUNCH = """
services:
  - name: bus
  - name: engine
    program: splatbus-engine-sim
    replicas: {engines}
    args: [--dynamics, --sun-rate, "6", --shared-clock, --fps, "{fps}", --pictures-s, "0"]
  - name: capture-bridge
    replicas: {engines}
    parameters: {{input_cameras: 12, input_size: 64, sample_budget: 20000, reference_rig: ring, reference_cameras: 8,
                 reference_size: 96, reference_rate_hz: 0, reference_refresh_hz: 500, light_depth_size: 256}}
  - name: expander
  - name: trainer
    parameters: {{threads: 1, max_gaussians: 20000}}
  - name: relight
  - name: streamer
  - name: viewer
    parameters: {{probe: true, probe_period_s: 1, threads: 1, width: 96, height: 96}}
"""


class Pipeline:
    def __init__(self, splatbus, folder, engines, fps):
        self.splatbus, self.bus, self.engines = splatbus, f"ipc://{folder}/bus", engines
        launch = pathlib.Path(folder) / "engines.yaml"
        launch.write_text(LAUNCH.format(engines=engines, fps=fps))
        self.process = subprocess.Popen([splatbus, "launch", str(launch), "--bus", self.bus], stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL, env=os.environ | {"XDG_STATE_HOME": folder})

    def ask(self, *arguments):
        done = subprocess.run([self.splatbus, *arguments, "--bus", self.bus], capture_output=True, text=True)
        return done.stdout

    def nodes(self):
        """By kind, what each process says of itself."""
        names = [json.loads(line) for line in self.ask("node", "list", "--json").splitlines()]
        kinds = {}
        for node in names:
            if node["kind"] in ("engine", "capture-bridge", "trainer"):
                kinds.setdefault(node["kind"], []).append(json.loads(self.ask("node", "info", node["source"], "--json")))
        return kinds

    def bridges(self, name):
        return sum(bridge["counters"].get(name, 0) for bridge in self.nodes().get("capture-bridge", []))


def measure(pipeline, seconds):
    def read():
        nodes = pipeline.nodes()
        sums = {name: sum(bridge["counters"].get(name, 0) for bridge in nodes["capture-bridge"])
                for name in ("references", "inputs", "frames_followed", "frames_unmatched")}
        sums["unpaired_views"] = nodes["trainer"][0]["counters"].get("unpaired_views", 0)
        for kind in ("engine", "capture-bridge"):
            sums[f"{kind} s"] = sum(node["processor_s"] for node in nodes[kind])
        return sums | {"time": time.monotonic()}

    before = read()
    echo = subprocess.Popen([pipeline.splatbus, "topic", "echo", "viewer/quality", "--json", "--bus", pipeline.bus],
                            stdout=subprocess.PIPE, text=True)
    time.sleep(seconds)
    after = read()
    echo.terminate()
    qualities = [json.loads(line)["message"] for line in echo.communicate()[0].splitlines() if line.startswith("{")]
    return {name: after[name] - before[name] for name in after}, [quality["ssim"] for quality in qualities]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--splatbus", default="build/release/bin/splatbus")
    parser.add_argument("--fps", type=float, default=8)
    parser.add_argument("--train", type=float, default=60, help="seconds before measuring")
    parser.add_argument("--seconds", type=float, default=30)
    options = parser.parse_args()
    for engines in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            pipeline = Pipeline(options.splatbus, folder, engines, options.fps)
            while pipeline.bridges("engines") < engines:
                time.sleep(0.5)
            time.sleep(options.train)
            got, ssims = measure(pipeline, options.seconds)
            pictures = got["references"] + got["inputs"]
            print(f"{engines}: {pictures / got['time']:.1f} pictures/s, of which {got['frames_followed']:.0f} followed, "
                  f"{got['frames_unmatched']:.0f} dropped without a version, {got['unpaired_views']:.0f} without "
                  f"visibility; processor time a picture: engines {1e3 * got['engine s'] / pictures:.1f} ms, bridges "
                  f"{1e3 * got['capture-bridge s'] / pictures:.2f} ms; SSIM {statistics.mean(ssims):.4f} of {len(ssims)}",
                  flush=True)
            pipeline.ask("down")
            pipeline.process.wait()


if __name__ == "__main__":
    main()
