#!/usr/bin/env python3
"""What replicas of relight gain: the processor time that the busiest one needs for a scene, with one, two and three.

The toy scene's sun turns while the trainer rests, so that each scene asks for the visibility of every page.
usage: bench/relight_replicas.py [--splatbus build/release/bin/splatbus] [--gaussians 100000] [--seconds 20]
"""
import argparse
import json
import os
import pathlib
import subprocess
import tempfile
import time

LAUNCH = """
services:
  - name: bus
  - name: engine
    program: splatbus-engine-sim
    args: [--sun-rate, "15", --fps, "5"]
  - name: capture-bridge
    parameters: {input_cameras: 24, input_size: 128, sample_budget: 200000, reference_rig: ring,
                 reference_cameras: 4, reference_size: 64, reference_rate_hz: 0.2}
  - name: expander
  - name: trainer
  - name: relight
"""


def processor_s(pid):
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Pipeline:
    def __init__(self, splatbus, folder):
        self.splatbus, self.bus = splatbus, f"ipc://{folder}/bus"
        launch = pathlib.Path(folder) / "relight.yaml"
        launch.write_text(LAUNCH)
        self.process = subprocess.Popen([splatbus, "launch", str(launch), "--bus", self.bus], stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL, env=os.environ | {"XDG_STATE_HOME": folder})

    def ask(self, *arguments):
        done = subprocess.run([self.splatbus, *arguments, "--bus", self.bus], capture_output=True, text=True)
        return done.stdout

    def nodes(self, kind):
        nodes = map(json.loads, self.ask("node", "list", "--json").splitlines())
        return {node["source"]: node for node in nodes if node["kind"] == kind}

    def counters(self, source):
        return json.loads(self.ask("node", "info", source, "--json"))["counters"]

    def gaussians(self):
        lines = self.ask("topic", "echo", "trainer/stats", "--once", "--json").splitlines()
        return json.loads(lines[-1])["message"]["gaussians"] if lines else 0


def measure(pipeline, replicas, seconds):
    pipeline.ask("scale", f"relight={replicas}")
    while len(pipeline.nodes("relight")) != replicas:
        time.sleep(0.2)
    time.sleep(4)  # until all of them know who shares
    nodes = pipeline.nodes("relight")

    def read():
        return {name: (processor_s(node["pid"]), pipeline.counters(name)["published"]) for name, node in nodes.items()}

    before = read()
    time.sleep(seconds)
    after = read()
    scenes = {name: after[name][1] - before[name][1] for name in nodes}
    return [1e3 * (after[name][0] - before[name][0]) / scenes[name] for name in nodes], min(scenes.values())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--splatbus", default="build/release/bin/splatbus")
    parser.add_argument("--gaussians", type=int, default=100000)
    parser.add_argument("--seconds", type=float, default=20)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        pipeline = Pipeline(options.splatbus, folder)
        while pipeline.gaussians() < options.gaussians:
            time.sleep(1)
        pipeline.ask("param", "set", "trainer", "paused", "true")
        print(f"{pipeline.gaussians()} Gaussians")
        alone = None
        for replicas in (1, 2, 3):
            busy, scenes = measure(pipeline, replicas, options.seconds)
            alone = alone or max(busy)
            each = ", ".join(f"{ms:.1f}" for ms in busy)
            print(f"{replicas}: {each} ms of processor time a scene ({scenes:.0f} scenes), {alone / max(busy):.2f} times")
        pipeline.ask("down")
        pipeline.process.wait()


if __name__ == "__main__":
    main()
