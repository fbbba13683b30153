#!/usr/bin/env python3
"""Every row of docs/experiments.md: writes the scenes, runs bench_raster once a row, prints the tables as markdown.

    bench/grid.py --bench build/cuda/bin/bench_raster --scene-writer scene.py --backend cuda --json rows.json
    bench/grid.py --bench build/release/bin/bench_raster --scene-writer scene.py --backend cpu --threads 2 \\
        --gaussians 208000 --sizes 256,512 --batches 1 --json rows.json
    bench/grid.py --from rows.json --roofline 1000000/sh3/512/4

The scene writer is called as `python3 WRITER -n GAUSSIANS --res PIXELS --ply FILE --cams FILE` and writes a 3DGS PLY and
cameras as bench_raster reads them; any scene will do. One program runs at a time. Results are kept after every row: the
same command goes on where it was stopped. Standard library only.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile
import time

MODELS = {
    "sh0": ["--sh", "0"],
    "sh3": ["--sh", "3"],
    "transfer": ["--appearance", "transfer"],
}
NAMES = {"sh0": "SH0", "sh3": "SH3", "transfer": "transfer"}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", help="the program bench_raster")
    parser.add_argument("--scene-writer", help="a script that writes scenes and cameras")
    parser.add_argument("--backend", default="cuda", choices=["cuda", "cpu"])
    parser.add_argument("--threads", type=int, default=0, help="CPU: 0 for all cores")
    parser.add_argument("--gaussians", default="208000,500000,1000000")
    parser.add_argument("--models", default="sh0,sh3,transfer")
    parser.add_argument("--sizes", default="256,512,1024", help="pixels of a picture's side")
    parser.add_argument("--batches", default="1,4,10", help="views a step")
    parser.add_argument("--modes", default="train,forward")
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--warmup", type=int, default=20)
    parser.add_argument("--timeout", type=float, default=120, help="seconds a row may take")
    parser.add_argument("--work", help="folder for scenes, kept; otherwise a temporary one")
    parser.add_argument("--json", help="where the results of all rows are kept")
    parser.add_argument("--from", dest="source", help="print these results, run nothing")
    parser.add_argument("--roofline", default="", help="rows to print stage by stage: GAUSSIANS/MODEL/SIZE/BATCH,...")
    return parser.parse_args()


def row_key(gaussians, model, size, batch, mode):
    return f"{gaussians}/{model}/{size}/{batch}/{mode}"


def write_scenes(options, folder, gaussians, sizes):
    """Scenes side by side, for writing them takes longer than a row."""

    def write(count, size, ply, cameras):
        command = [sys.executable, options.scene_writer, "-n", str(count), "--res", str(size), "--cams", cameras]
        return subprocess.Popen(command + (["--ply", ply] if ply else []), stdout=subprocess.DEVNULL)

    started = []
    for count in gaussians:
        ply = os.path.join(folder, f"scene{count}.ply")
        if not os.path.exists(ply):
            started.append(write(count, sizes[0], ply, os.path.join(folder, f"unused{count}.json")))
    for size in sizes:
        started.append(write(10, size, None, os.path.join(folder, f"cameras{size}.json")))
    if any(process.wait() != 0 for process in started):
        raise SystemExit("grid: the scene writer failed")


def run_row(options, folder, gaussians, model, size, batch, mode):
    """The result of one run of bench_raster, or None when it failed."""
    with tempfile.NamedTemporaryFile(suffix=".json", dir=folder) as out:
        command = [
            options.bench, "--scene", os.path.join(folder, f"scene{gaussians}.ply"),
            "--cams", os.path.join(folder, f"cameras{size}.json"), "--backend", options.backend, "--mode", mode,
            "--batch", str(batch), "--threads", str(options.threads), "--iterations", str(options.iterations),
            "--warmup", str(options.warmup), "--json", out.name,
        ] + MODELS[model]
        try:
            done = subprocess.run(command, stderr=subprocess.PIPE, timeout=options.timeout, check=False, text=True)
        except subprocess.TimeoutExpired:
            print(f"grid: took longer than {options.timeout} s: {' '.join(command)}", file=sys.stderr)
            return None
        if done.returncode != 0:
            print(f"grid: {' '.join(command)}\n{done.stderr}", file=sys.stderr)
            return None
        return json.load(open(out.name, encoding="utf-8"))


def save(path, rows):
    """Whole or not at all, for a run may be cut off."""
    if not path:
        return
    with open(path + ".part", "w", encoding="utf-8") as file:
        json.dump(rows, file, indent=1)
    os.replace(path + ".part", path)


def run_all(options):
    rows = {}
    if options.json and os.path.exists(options.json):
        rows = json.load(open(options.json, encoding="utf-8"))
    gaussians = [int(n) for n in options.gaussians.split(",")]
    sizes = [int(size) for size in options.sizes.split(",")]
    batches = [int(batch) for batch in options.batches.split(",")]
    keys = [(n, model, size, batch, mode) for size in sizes for model in options.models.split(",") for n in gaussians
            for batch in batches for mode in options.modes.split(",")]
    keys = [key for key in keys if row_key(*key) not in rows]
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.work or temporary
        os.makedirs(folder, exist_ok=True)
        begin = time.monotonic()
        write_scenes(options, folder, gaussians, sizes)
        print(f"grid: scenes written in {time.monotonic() - begin:.1f} s, {len(keys)} rows to run", file=sys.stderr)
        for done, key in enumerate(keys, 1):
            result = run_row(options, folder, *key)
            if result is not None:
                rows[row_key(*key)] = result
                save(options.json, rows)
            if done % 10 == 0 or done == len(keys):
                print(f"grid: {done} of {len(keys)} rows, {time.monotonic() - begin:.1f} s", file=sys.stderr)
    return rows


def count_name(gaussians):
    return f"{gaussians // 1000000}M" if gaussians % 1000000 == 0 else f"{gaussians // 1000}K"


def figures(row):
    if row is None:
        return "- | - | -"
    return f"{row['ms_median']:.3f} | {row['views_per_s']:,.0f} | {row['peak_mib']:,.0f}"


def print_rows(rows):
    """A table a model, a line for what shares everything but the mode."""
    lines = sorted({tuple(key.split("/")[:4]) for key in rows}, key=lambda k: (int(k[2]), int(k[0]), int(k[3])))
    for model in (m for m in MODELS if any(line[1] == m for line in lines)):
        print(f"\n{NAMES[model]}:\n")
        print("| N | size | batch | train ms | views/s | MiB | forward ms | frames/s | MiB |")
        print("|---|---|---|---|---|---|---|---|---|")
        for count, _, size, batch in (line for line in lines if line[1] == model):
            train, forward = (rows.get(row_key(count, model, size, batch, mode)) for mode in ("train", "forward"))
            print(f"| {count_name(int(count))} | {size} | {batch} | {figures(train)} | {figures(forward)} |")


def print_roofline(rows, name):
    row = rows.get(f"{name}/train") or rows.get(f"{name}/forward")
    if row is None:
        raise SystemExit(f"grid: no row {name}")
    machine, work = row["machine"], row["work"]
    print(f"\n{name}, {row['mode']}: {machine['bytes_per_s'] * 1e-9:,.0f} GB/s, "
          f"{machine['operations_per_s'] * 1e-9:,.0f} G multiply-adds/s")
    print(", ".join(f"{key} {value:,.0f}" for key, value in work.items()) + "\n")
    print("| stage | MB | M operations | floor ms | bound | measured ms | times the floor |")
    print("|---|---|---|---|---|---|---|")
    for stage, line in sorted(row["roofline"].items(), key=lambda item: -item[1]["measured_ms"]):
        print(f"| {stage} | {line['bytes'] * 1e-6:,.1f} | {line['operations'] * 1e-6:,.0f} | {line['floor_ms']:.4f} "
              f"| {line['bound']} | {line['measured_ms']:.3f} | {line['times_floor']:.1f} |")


def main():
    options = arguments()
    if options.source:
        rows = json.load(open(options.source, encoding="utf-8"))
    elif options.bench and options.scene_writer:
        rows = run_all(options)
    else:
        raise SystemExit("grid: --bench and --scene-writer, or --from, are needed")
    print_rows(rows)
    for name in filter(None, options.roofline.split(",")):
        print_roofline(rows, name)


if __name__ == "__main__":
    main()
