#!/usr/bin/env python3
"""What `topic hz`, `topic bw` and `top` on every topic cost a pipeline that trains.

Runs a launch file on a bus of its own, and compares the trainer's views a second with and without the three, in turns.
Prints the median of the ratios, the processor time of the three and of the broker, what share of all cores that is (which
tells small costs better than rates, whose pairs differ by some percent), and whether the broker copied anything.
usage: bench/watch_cost.py [--splatbus build/release/bin/splatbus] [--launch launch/demo.yaml] [--seconds 10] [--pairs 6]
"""
import argparse
import json
import os
import statistics
import subprocess
import tempfile
import time

WATCHERS = (["topic", "hz"], ["topic", "bw"], ["top", "--json"])


def processor_s(pid):
    with open(f"/proc/{pid}/stat") as file:
        fields = file.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Pipeline:
    def __init__(self, options, bus):
        self.splatbus, self.bus = options.splatbus, bus
        self.process = subprocess.Popen([options.splatbus, "launch", options.launch, "--bus", bus],
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def ask(self, *arguments):
        done = subprocess.run([self.splatbus, *arguments, "--bus", self.bus], capture_output=True, text=True)
        return done.stdout

    def nodes(self):
        return {node["source"]: node for node in map(json.loads, self.ask("node", "list", "--json").splitlines())}

    def trained(self):
        """Views so far, and the time at which the trainer said it, s."""
        line = self.ask("topic", "echo", "trainer/stats", "--once", "--json").splitlines()[-1]
        message = json.loads(line)["message"]
        return message["views"], message["header"]["publish_ns"] * 1e-9

    def rate(self, seconds):
        before, then = self.trained()
        time.sleep(seconds)
        after, now = self.trained()
        return (after - before) / (now - then)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--splatbus", default="build/release/bin/splatbus")
    parser.add_argument("--launch", default="launch/demo.yaml")
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--pairs", type=int, default=6)
    parser.add_argument("--warm-up", type=float, default=20)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        pipeline = Pipeline(options, f"ipc://{folder}/bus")
        try:
            time.sleep(options.warm_up)
            broker = pipeline.nodes()["bus"]["pid"]
            ratios, watching_s, broker_s = [], [], {False: [], True: []}
            for pair in range(options.pairs):
                rates = {}
                # In turns, so that what grows or slows down by itself weighs on both alike.
                for watched in (False, True) if pair % 2 == 0 else (True, False):
                    tools = [subprocess.Popen([options.splatbus, *tool, "--bus", pipeline.bus], stdout=subprocess.DEVNULL)
                             for tool in WATCHERS if watched]
                    time.sleep(1)
                    began = {pid: processor_s(pid) for pid in [broker, *(tool.pid for tool in tools)]}
                    begin = time.monotonic()
                    rates[watched] = pipeline.rate(options.seconds)
                    took = time.monotonic() - begin
                    broker_s[watched].append((processor_s(broker) - began[broker]) / took)
                    if watched:
                        watching_s.append(sum(processor_s(tool.pid) - began[tool.pid] for tool in tools) / took)
                    for tool in tools:
                        tool.terminate()
                        tool.wait()
                ratios.append(rates[True] / rates[False])
                print(f"{rates[False]:.1f} views/s alone, {rates[True]:.1f} watched: {ratios[-1]:.4f}", flush=True)
            inlined = pipeline.nodes()["bus"]["counters"]["inlined"]
        finally:
            pipeline.process.terminate()
            pipeline.process.wait()
    more_s = statistics.median(watching_s) + statistics.median(broker_s[True]) - statistics.median(broker_s[False])
    print(f"median ratio {statistics.median(ratios):.4f}; of one core the three take {statistics.median(watching_s):.2%}, "
          f"the broker {statistics.median(broker_s[False]):.2%} alone and {statistics.median(broker_s[True]):.2%} watched: "
          f"{more_s / len(os.sched_getaffinity(0)):.2%} of all cores more; messages that it copied payloads into: {inlined:.0f}")


if __name__ == "__main__":
    main()
