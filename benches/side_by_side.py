"""Times the original MV-DUSt3R(+) in PyTorch and tid3r side by side, on the CPU.

Each round runs both for every number of views, one right after the other, and rounds take turns in
which goes first. Every run is a process of its own: one forward pass that is not timed, one that is.
The table gives medians over the rounds of the seconds, and the most memory that a process of either
had resident (for PyTorch from its start, libraries and construction included; for tid3r from when its
weights stand in memory). Weights are random, of full size, and pictures 224x224 in single precision:
speed depends on neither.

Figures count on an idle machine only: other work slows the two sides by different factors. On Linux the
script measures how many cores other processes kept busy during each run, and says so.

The original always computes all of its outputs: Gaussians, and all paths of MV-DUSt3R+. tid3r computes
what a reconstruction needs (points and confidences of the first path), unless told to compute the
same by --all-outputs.

Needs a checkout of https://github.com/facebookresearch/mvdust3r, a release build of tid3r, and a
Python with torch, numpy, einops and huggingface_hub. Other packages that the original imports, its
network does not use; where they are missing, empty stand-ins take their place.

    python3 benches/side_by_side.py --upstream ../mvdust3r --tid3r target/release/tid3r --threads 2
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.abc
import importlib.machinery
import json
import os
import resource
import statistics
import subprocess
import sys
import time
import types
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

SIDE = 224
"""Width and height of the pictures, in pixels."""

REFERENCES = 4
"""Reference views, and so paths, of MV-DUSt3R+."""

UNUSED = {
    "PIL",
    "cv2",
    "gsplat",
    "imageio",
    "matplotlib",
    "pytorch3d",
    "scipy",
    "torchmetrics",
    "torchvision",
}
"""Packages that the original imports for training, data and rendering."""


@dataclass
class Side:
    """What was measured of one implementation at one number of views."""

    seconds: list[float] = field(default_factory=list)
    peak_bytes: list[int] = field(default_factory=list)

    def add(self, seconds: float, peak_bytes: int | None) -> None:
        self.seconds.append(seconds)
        if peak_bytes is not None:
            self.peak_bytes.append(peak_bytes)

    def median(self) -> float:
        return statistics.median(self.seconds)

    def peak(self) -> str:
        return f"{max(self.peak_bytes) / 1e9:.2f} GB" if self.peak_bytes else "?"


class OtherWork:
    """Measures how busy other processes keep the machine while children of this one run."""

    def __init__(self) -> None:
        self.start = time.perf_counter(), self.busy()

    @staticmethod
    def busy() -> float:
        """CPU seconds so far of all processes but this one's finished children; 0 where the system does not say."""
        try:
            fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
        except OSError:
            return 0.0
        # The fourth and fifth are idle; after the eighth come parts of the first two.
        ticks = sum(int(ticks) for ticks in fields[:3] + fields[5:8])
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return ticks / os.sysconf("SC_CLK_TCK") - children.ru_utime - children.ru_stime

    def cores(self) -> float:
        """Cores that were busy with other work since this was made."""
        start, busy = self.start
        return (self.busy() - busy) / (time.perf_counter() - start)


class StandIn(types.ModuleType):
    """A module of which everything can be imported, and nothing is of use."""

    def __getattr__(self, name: str) -> MagicMock:
        # Those with underscores tell the import system what a module can do.
        if name.startswith("__"):
            raise AttributeError(name)
        return MagicMock()


class StandIns(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Puts stand-ins in the place of packages of `UNUSED` that no finder before this one finds."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        if name.split(".")[0] in UNUSED:
            return importlib.machinery.ModuleSpec(name, self, is_package=True)
        return None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> types.ModuleType:
        return StandIn(spec.name)

    def exec_module(self, module: types.ModuleType) -> None:
        pass


def time_original(upstream: Path, model: str, views: int, threads: int) -> dict[str, Any]:
    """Builds the original network in this process and times one forward pass, after one that is not timed."""
    import huggingface_hub  # noqa: F401  before the stand-ins: it looks for what is installed
    import torch

    # Without it the original looks for modules that were never published.
    os.environ["META_INTERNAL"] = "False"
    sys.path.insert(0, str(upstream))
    sys.meta_path.append(StandIns())
    from dust3r.model import AsymmetricCroCo3DStereoMultiView

    torch.set_num_threads(threads)
    torch.manual_seed(0)
    infinity = float("inf")
    plus = model == "mvdust3r-plus"
    network = AsymmetricCroCo3DStereoMultiView(
        pos_embed="RoPE100",
        img_size=(SIDE, SIDE),
        head_type="linear",
        output_mode="pts3d",
        depth_mode=("exp", -infinity, infinity),
        conf_mode=("exp", 1, 1e9),
        enc_embed_dim=1024,
        enc_depth=24,
        enc_num_heads=16,
        dec_embed_dim=768,
        dec_depth=12,
        dec_num_heads=12,
        landscape_only=False,
        GS=True,
        sh_degree=0,
        pts_head_config={"skip": True},
        m_ref_flag=plus,
        n_ref=REFERENCES if plus else None,
    ).eval()
    pictures = [{"img": torch.rand(1, 3, SIDE, SIDE) * 2 - 1} for _ in range(views)]
    with torch.inference_mode():
        network(pictures[0], pictures[1:])
        start = time.perf_counter()
        network(pictures[0], pictures[1:])
        seconds = time.perf_counter() - start
    unit = 1 if sys.platform == "darwin" else 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    return {"seconds": seconds, "peak_memory_bytes": peak, "version": f"torch {torch.__version__}"}


def output_of(command: list[str], environment: dict[str, str] | None = None) -> str:
    """What a command prints; if it fails, what it complained of ends this script."""
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    except OSError as error:
        sys.exit(f"{command[0]} cannot be run: {error}")
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}\nfailed ({done.returncode}):\n{done.stderr.strip()[-2000:]}")
    return done.stdout


def run_original(args: argparse.Namespace, views: int) -> tuple[float, int | None, str]:
    """Seconds, peak memory and version of the original, in a process of its own."""
    command = [sys.executable, "-W", "ignore", __file__, "--original-alone"]
    command += ["--upstream", str(args.upstream), "--tid3r", str(args.tid3r)]
    command += ["--model", args.model, "--views", str(views), "--threads", str(args.threads)]
    threads = str(args.threads)
    result = json.loads(output_of(command, {**os.environ, "OMP_NUM_THREADS": threads, "MKL_NUM_THREADS": threads}))
    return result["seconds"], result["peak_memory_bytes"], result["version"]


def run_tid3r(args: argparse.Namespace, views: int) -> tuple[float, int | None]:
    """Seconds and peak memory of tid3r, in a process of its own."""
    command = [str(args.tid3r), "bench", "--model", args.model, "--views", str(views)]
    command += ["--threads", str(args.threads), "--runs", "1", "--json", "--quiet"]
    if args.all_outputs:
        command += ["--gaussians", "--all-paths"]
    (row,) = json.loads(output_of(command))
    return row["median_seconds"], row["peak_memory_bytes"]


def compare(args: argparse.Namespace) -> None:
    """Runs all rounds, and prints the table."""
    original = {views: Side() for views in args.views}
    tid3r = {views: Side() for views in args.views}
    version = ""
    disturbance = 0.0
    for turn in range(args.rounds):
        for views in args.views:
            theirs, ours = original[views], tid3r[views]
            for original_now in [turn % 2 == 0, turn % 2 != 0]:
                meter = OtherWork()
                if original_now:
                    seconds, peak, version = run_original(args, views)
                    theirs.add(seconds, peak)
                else:
                    ours.add(*run_tid3r(args, views))
                disturbance = max(disturbance, meter.cores())
            both = f"original {theirs.seconds[-1]:.2f} s, tid3r {ours.seconds[-1]:.2f} s"
            print(f"round {turn + 1}, {views} views: {both}", file=sys.stderr, flush=True)

    own_version = output_of([str(args.tid3r), "--version"]).strip()
    outputs = "all outputs" if args.all_outputs else "points and confidences"
    print(f"{args.model}, {SIDE}x{SIDE}, {args.threads} threads, median of {args.rounds}")
    print(f"original: {version}, all outputs; {own_version}: {outputs}\n")
    columns = ["views", "original", "tid3r", "original / tid3r", "original's memory", "tid3r's memory"]
    print("  ".join(columns))
    for views in args.views:
        theirs, ours = original[views], tid3r[views]
        cells = [str(views), f"{theirs.median():.2f} s", f"{ours.median():.2f} s"]
        cells += [f"{theirs.median() / ours.median():.2f}", theirs.peak(), ours.peak()]
        print("  ".join(cell.rjust(len(column)) for cell, column in zip(cells, columns)))
    if disturbance > 0.1:
        print(f"\nDo not trust these figures: other work kept up to {disturbance:.1f} cores busy meanwhile.")


def positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise ValueError(text)
    return number


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--upstream", type=Path, required=True, help="checkout of facebookresearch/mvdust3r")
    parser.add_argument("--tid3r", type=Path, required=True, help="the program, built with --release")
    parser.add_argument("--model", choices=["mvdust3r", "mvdust3r-plus"], default="mvdust3r")
    parser.add_argument("--views", default="4,8", help="numbers of photos (default: %(default)s)")
    parser.add_argument("--threads", type=positive, default=2, help="threads of each side (default: %(default)s)")
    parser.add_argument("--rounds", type=positive, default=3, help="timed runs of each side (default: %(default)s)")
    parser.add_argument("--all-outputs", action="store_true", help="let tid3r, too, compute Gaussians and all paths")
    parser.add_argument("--original-alone", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()

    least = REFERENCES if args.model == "mvdust3r-plus" else 2
    try:
        args.views = [int(views) for views in args.views.split(",")]
    except ValueError:
        parser.error(f"--views {args.views}: give numbers such as 4,8")
    if min(args.views) < least:
        parser.error(f"{args.model} needs {least} views or more")
    if not (args.upstream / "dust3r" / "model.py").is_file():
        parser.error(f"{args.upstream} is no checkout of facebookresearch/mvdust3r: it has no dust3r/model.py")
    args.upstream, args.tid3r = args.upstream.resolve(), args.tid3r.resolve()
    return args


def main() -> None:
    args = arguments()
    if not args.original_alone:
        return compare(args)
    # The original prints as it is imported.
    with contextlib.redirect_stdout(sys.stderr):
        result = time_original(args.upstream, args.model, args.views[0], args.threads)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
