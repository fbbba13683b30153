#!/usr/bin/env python3
"""What replicas of the capture-bridge gain: the processor time that the busiest one needs for an input picture.

The toys move under a turning sun, so that input pictures are rendered again all the time; the engine limits, not the
bridges. Numbers of bridges follow each other on one bus, while it runs.
usage: bench/bridge_replicas.py [--splatbus build/release/bin/splatbus] [--replicas 1 2 1 2] [--size 128] [--seconds 30]
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
    args: [--dynamics, --sun-rate, "6", --fps, "10"]
  - name: capture-bridge
    parameters: {{reference_cameras: 0, input_cameras: 24, input_size: {size}, sample_budget: 60000, input_rate_hz: 10,
                 input_deadline_s: 60, light_depth_size: 64}}
"""


class Pipeline:
    def __init__(self, splatbus, folder, size):
        self.splatbus, self.bus = splatbus, f"ipc://{folder}/bus"
        launch = pathlib.Path(folder) / "bridges.yaml"
        launch.write_text(LAUNCH.format(size=size))
        self.process = subprocess.Popen([splatbus, "launch", str(launch), "--bus", self.bus], stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL, env=os.environ | {"XDG_STATE_HOME": folder})

    def ask(self, *arguments):
        done = subprocess.run([self.splatbus, *arguments, "--bus", self.bus], capture_output=True, text=True)
        return done.stdout

    def bridges(self):
        nodes = map(json.loads, self.ask("node", "list", "--json").splitlines())
        names = [node["source"] for node in nodes if node["kind"] == "capture-bridge"]
        return {name: json.loads(self.ask("node", "info", name, "--json")) for name in names}


def lead(bridges):
    return next((name for name, bridge in bridges.items() if bridge["counters"].get("input_rounds", 0) > 0), None)


def is_ready(bridges, replicas):
    leads = lead(bridges)
    return len(bridges) == replicas and leads and bridges[leads]["counters"].get("helpers", 0) == replicas - 1


def measure(pipeline, replicas, seconds):
    pipeline.ask("scale", f"capture-bridge={replicas}")
    while not is_ready(pipeline.bridges(), replicas):
        time.sleep(0.5)
    time.sleep(3)
    before = pipeline.bridges()
    begin = time.monotonic()
    time.sleep(seconds)
    after = pipeline.bridges()
    took = time.monotonic() - begin
    leads = lead(after)
    gain = {name: after[leads]["counters"][name] - before[leads]["counters"][name]
            for name in ("inputs", "input_rounds", "rounds_handed", "rounds_came_back")}
    busy = {name: 1e3 * (after[name]["processor_s"] - before[name]["processor_s"]) / gain["inputs"] for name in after}
    return busy, gain, took


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--splatbus", default="build/release/bin/splatbus")
    parser.add_argument("--replicas", type=int, nargs="+", default=[1, 2, 1, 2])
    parser.add_argument("--size", type=int, default=128, help="of input pictures, pixels a side")
    parser.add_argument("--seconds", type=float, default=30)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        pipeline = Pipeline(options.splatbus, folder, options.size)
        alone = None
        for replicas in options.replicas:
            busy, gain, took = measure(pipeline, replicas, options.seconds)
            alone = alone or max(busy.values())
            each = ", ".join(f"{ms:.2f}" for ms in busy.values())
            print(f"{replicas}: {each} ms of processor time an input picture, {alone / max(busy.values()):.2f} times; "
                  f"{gain['inputs'] / took:.1f} pictures/s, {gain['input_rounds'] / took:.1f} rounds/s, "
                  f"{gain['rounds_handed']:.0f} of {gain['input_rounds']:.0f} rounds sampled by others, "
                  f"{gain['rounds_came_back']:.0f} came back", flush=True)
        pipeline.ask("down")
        pipeline.process.wait()


if __name__ == "__main__":
    main()
