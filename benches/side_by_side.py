"""Times the original networks in PyTorch and tid3r side by side, on the CPU.

Each round runs both for every load (numbers of photos, of boxes, of frames), one right after the other, and rounds
take turns in which goes first. Every run is a process of its own: one forward pass that is not timed, one
that is. The table gives medians over the rounds of the seconds, and the most memory that a process of either
had resident (for PyTorch from its start, libraries and construction included; for tid3r from when its
weights are open). Weights are random, of full size, and so are the inputs: speed depends on neither.
The original computes in single precision, tid3r in what --dtype says. tid3r has its weights from a file, as its
users do: that of --weights, or one that is made up first (in a folder that goes afterwards, unless --cache names
one), in f32 or bf16 like the numbers that it computes with. MV-DUSt3R(+) sees pictures of 224x224, MobileSAMv2 of
1024x1024. See3D's UNet denoises one group of frames of 256x256 (32x32 latents), its VAE decodes
256x256, its CLIPs see one picture and one text.

Figures count on an idle machine only: other work slows the two sides by different factors. On Linux the
script measures how many cores other processes kept busy during each run, and says so.

The original always computes all of its outputs: Gaussians, all paths of MV-DUSt3R+, mask coefficients of the
detector. tid3r computes what is used (points and confidences of the first path; boxes and scores), unless
told to compute all of MV-DUSt3R's by --all-outputs. Batch norms are folded on both sides.

Needs a release build of tid3r, and

- for MV-DUSt3R(+) a checkout of https://github.com/facebookresearch/mvdust3r, and a Python with torch, numpy,
  einops and huggingface_hub;
- for MobileSAMv2 a checkout of https://github.com/ChaoningZhang/MobileSAM, and a Python with torch,
  torchvision, timm, numpy, opencv-python-headless, pyyaml, requests, tqdm and setuptools < 81;
- for See3D a checkout of https://github.com/baaivision/See3D, and a Python with torch, numpy < 2, einops, diffusers
  0.27, transformers 4.41 and huggingface_hub < 0.26. Its attention is PyTorch's own instead of xformers', which
  has none for CPUs.

Other packages that the originals import, their networks do not use; where they are missing, empty
stand-ins take their place.

    python3 benches/side_by_side.py --upstream ../mvdust3r --tid3r target/release/tid3r --threads 2
    python3 benches/side_by_side.py --upstream ../MobileSAM --tid3r target/release/tid3r --model mobilesamv2-decoder
    python3 benches/side_by_side.py --upstream ../See3D --tid3r target/release/tid3r --model see3d-sparse --load 3
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
import tempfile
import time
import types
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

REFERENCES = 4
"""Reference views, and so paths, of MV-DUSt3R+."""

UNUSED = {
    "PIL",
    "cv2",
    "gsplat",
    "imageio",
    "kiui",
    "matplotlib",
    "onnx",
    "onnxsim",
    "pandas",
    "psutil",
    "pytorch3d",
    "scipy",
    "seaborn",
    "thop",
    "torchmetrics",
    "torchpack",
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
    """Puts stand-ins in the place of packages that no finder before this one finds."""

    def __init__(self, packages: set[str] = UNUSED) -> None:
        self.packages = packages

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        if name.split(".")[0] in self.packages:
            return importlib.machinery.ModuleSpec(name, self, is_package=True)
        return None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> types.ModuleType:
        return StandIn(spec.name)

    def exec_module(self, module: types.ModuleType) -> None:
        pass


def mvdust3r(upstream: Path, model: str, views: int) -> Callable[[], object]:
    """The original MV-DUSt3R(+), to be run on `views` pictures."""
    import huggingface_hub  # noqa: F401  before the stand-ins: it looks for what is installed
    import torch

    # Without it the original looks for modules that were never published.
    os.environ["META_INTERNAL"] = "False"
    sys.path.insert(0, str(upstream))
    sys.meta_path.append(StandIns())
    # For the losses, which are imported, too, it would fetch the weights of a classifier.
    sys.meta_path.insert(0, StandIns({"torchmetrics"}))
    from dust3r.model import AsymmetricCroCo3DStereoMultiView

    infinity = float("inf")
    plus = model == "mvdust3r-plus"
    network = AsymmetricCroCo3DStereoMultiView(
        pos_embed="RoPE100",
        img_size=(224, 224),
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
    pictures = [{"img": torch.rand(1, 3, 224, 224) * 2 - 1} for _ in range(views)]
    return lambda: network(pictures[0], pictures[1:])


def mobilesamv2(upstream: Path, model: str, boxes: int) -> Callable[[], object]:
    """A network of the original MobileSAMv2; the decoder makes masks of `boxes` boxes in one batch."""
    import torch

    sys.path.insert(0, str(upstream / "MobileSAMv2"))
    sys.meta_path.append(StandIns())
    picture = torch.rand(1, 3, 1024, 1024)
    if model == "mobilesamv2-detector":
        from ultralytics.nn.tasks import SegmentationModel, yaml_model_load

        layout = yaml_model_load(upstream / "MobileSAMv2/ultralytics/models/v8/yolov8-seg.yaml")
        detector = SegmentationModel({**layout, "scale": "x"}, ch=3, nc=1, verbose=False).eval().fuse(verbose=False)
        return lambda: detector(picture)
    from mobilesamv2 import build_sam

    if model == "mobilesamv2-decoder":
        parts = build_sam.build_PromptGuidedDecoder()
        prompt_encoder, mask_decoder = parts["PromtEncoder"].eval(), parts["MaskDecoder"].eval()
        features = torch.randn(1, 256, 64, 64)
        corners = torch.rand(boxes, 4) * 512
        corners[:, 2:] += 512

        def decode() -> object:
            sparse, dense = prompt_encoder(points=None, boxes=corners, masks=None)
            return mask_decoder(
                image_embeddings=features.repeat_interleave(boxes, 0),
                image_pe=prompt_encoder.get_dense_pe().repeat_interleave(boxes, 0),
                sparse_prompt_embeddings=sparse,
                dense_prompt_embeddings=dense,
                multimask_output=False,
                simple_type=True,
            )

        return decode
    if model == "mobilesamv2-efficientvit-l2":
        backbone = build_sam.EfficientViTLargeBackbone(
            width_list=[32, 64, 128, 256, 512],
            depth_list=[1, 2, 2, 8, 8],
            in_channels=3,
            qkv_dim=32,
            norm="bn2d",
            act_func="gelu",
        )
        neck = build_sam.SamNeck(
            fid_list=["stage4", "stage3", "stage2"],
            in_channel_list=[512, 256, 128],
            head_width=256,
            head_depth=12,
            expand_ratio=1,
            middle_op="fmbconv",
            out_dim=256,
        )
        encoder = build_sam.EfficientViTSamImageEncoder(backbone, neck)
    elif model == "mobilesamv2-tiny-vit":
        encoder = build_sam.build_sam_vit_t_encoder()
    else:
        encoder = build_sam.build_sam_vit_h_encoder()
    encoder.eval()
    return lambda: encoder(picture)


def see3d(upstream: Path, model: str, frames: int) -> Callable[[], object]:
    """A network of the original See3D; the UNet denoises one group of `frames` frames."""
    import torch

    if model == "see3d-sparse":
        import diffusers.models.modeling_utils  # noqa: F401  before the stand-ins: it looks for what is installed

        attention = types.ModuleType("xformers.ops")
        attention.memory_efficient_attention = lambda q, k, v, attn_bias, op: (
            torch.nn.functional.scaled_dot_product_attention(q, k, v)
        )
        package = types.ModuleType("xformers")
        package.ops = attention
        sys.modules |= {"xformers": package, "xformers.ops": attention}
        sys.path.insert(0, str(upstream))
        sys.meta_path.append(StandIns())
        from mv_unet import MultiViewUNetModel

        unet = MultiViewUNetModel(
            image_size=32,
            in_channels=9,
            model_channels=320,
            out_channels=4,
            num_res_blocks=2,
            attention_resolutions=[4, 2, 1],
            channel_mult=[1, 2, 4, 4],
            num_head_channels=64,
            context_dim=1024,
        ).eval()
        latents, timesteps = torch.randn(frames, 9, 32, 32), torch.full([frames], 500.0)
        context = torch.randn(frames, 77, 1024)
        return lambda: unet(latents, timesteps, context, num_frames=frames)
    if model == "see3d-vae":
        from diffusers import AutoencoderKL

        vae = AutoencoderKL(
            down_block_types=["DownEncoderBlock2D"] * 4,
            up_block_types=["UpDecoderBlock2D"] * 4,
            block_out_channels=[128, 256, 512, 512],
            layers_per_block=2,
        ).eval()
        latents = torch.randn(1, 4, 32, 32)
        return lambda: vae.decode(latents)
    import transformers

    if model == "see3d-image-encoder":
        encoder = transformers.CLIPVisionModelWithProjection(
            transformers.CLIPVisionConfig(
                hidden_size=1280,
                intermediate_size=5120,
                projection_dim=1024,
                num_hidden_layers=32,
                num_attention_heads=16,
                patch_size=14,
                hidden_act="gelu",
            )
        ).eval()
        picture = torch.randn(1, 3, 224, 224)
        return lambda: encoder(picture)
    text_encoder = transformers.CLIPTextModel(
        transformers.CLIPTextConfig(
            hidden_size=1024,
            intermediate_size=4096,
            num_hidden_layers=23,
            num_attention_heads=16,
            hidden_act="gelu",
        )
    ).eval()
    tokens = torch.tensor([[49406, 49407] + [0] * 75])
    return lambda: text_encoder(tokens)


MODELS = {
    "mvdust3r": ("views", mvdust3r),
    "mvdust3r-plus": ("views", mvdust3r),
    "mobilesamv2-detector": (None, mobilesamv2),
    "mobilesamv2-efficientvit-l2": (None, mobilesamv2),
    "mobilesamv2-tiny-vit": (None, mobilesamv2),
    "mobilesamv2-sam-vit-h": (None, mobilesamv2),
    "mobilesamv2-decoder": ("boxes", mobilesamv2),
    "see3d-sparse": ("views", see3d),
    "see3d-vae": (None, see3d),
    "see3d-image-encoder": (None, see3d),
    "see3d-text-encoder": (None, see3d),
}
"""For each network, what its load is counted in, and what makes the original."""

UPSTREAM = {
    mvdust3r: ("facebookresearch/mvdust3r", "dust3r/model.py"),
    mobilesamv2: ("ChaoningZhang/MobileSAM", "MobileSAMv2/mobilesamv2/build_sam.py"),
    see3d: ("baaivision/See3D", "mv_unet.py"),
}
"""For each maker, the repository of the original, and a file by which a checkout is known."""


def time_original(upstream: Path, model: str, load: int, threads: int) -> dict[str, Any]:
    """Builds the original network in this process and times one forward pass, after one that is not timed."""
    import torch

    torch.set_num_threads(threads)
    torch.manual_seed(0)
    _, original = MODELS[model]
    with torch.inference_mode():
        forward = original(upstream, model, load)
        forward()
        start = time.perf_counter()
        forward()
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


def made_up_weights(args: argparse.Namespace, parent: Path) -> Path:
    """The folder of made-up weights of the network below `parent`; they are made if they are not there."""
    folder = parent / f"{args.model}-{args.dtype}"
    if not (folder / "config.json").is_file():
        print(f"making up weights in {folder}", file=sys.stderr, flush=True)
        command = [str(args.tid3r), "weights", "synthesize", args.model, "--quiet"]
        output_of([*command, "--dtype", args.dtype, "--output", str(folder)])
    return folder


def run_original(args: argparse.Namespace, load: int) -> tuple[float, int | None, str]:
    """Seconds, peak memory and version of the original, in a process of its own."""
    command = [sys.executable, "-W", "ignore", __file__, "--original-alone"]
    command += ["--upstream", str(args.upstream), "--tid3r", str(args.tid3r)]
    command += ["--model", args.model, "--load", str(load), "--threads", str(args.threads)]
    threads = str(args.threads)
    result = json.loads(output_of(command, {**os.environ, "OMP_NUM_THREADS": threads, "MKL_NUM_THREADS": threads}))
    return result["seconds"], result["peak_memory_bytes"], result["version"]


def run_tid3r(args: argparse.Namespace, load: int) -> tuple[float, int | None]:
    """Seconds and peak memory of tid3r, in a process of its own."""
    command = [str(args.tid3r), "bench", "--model", args.model]
    unit, _ = MODELS[args.model]
    if unit:
        command += [f"--{unit}", str(load)]
    if args.model in ("see3d-sparse", "see3d-vae"):
        command += ["--size", "256"]
    command += ["--threads", str(args.threads), "--runs", "1", "--json", "--quiet"]
    command += ["--dtype", args.dtype, "--weights", str(args.weights)]
    if args.all_outputs:
        command += ["--gaussians", "--all-paths"]
    # Of See3D's VAE, which has two rows, the original decodes.
    row = json.loads(output_of(command))[-1]
    return row["median_seconds"], row["peak_memory_bytes"]


def compare(args: argparse.Namespace) -> None:
    """Runs all rounds, and prints the table; with made-up weights unless there are others."""
    with tempfile.TemporaryDirectory() as temporary:
        if args.weights is None:
            args.weights = made_up_weights(args, args.cache or Path(temporary))
        measure(args)


def measure(args: argparse.Namespace) -> None:
    """Runs all rounds, and prints the table."""
    unit = MODELS[args.model][0] or "picture"
    original = {load: Side() for load in args.loads}
    tid3r = {load: Side() for load in args.loads}
    version = ""
    disturbance = 0.0
    for turn in range(args.rounds):
        for load in args.loads:
            theirs, ours = original[load], tid3r[load]
            for original_now in [turn % 2 == 0, turn % 2 != 0]:
                meter = OtherWork()
                if original_now:
                    seconds, peak, version = run_original(args, load)
                    theirs.add(seconds, peak)
                else:
                    ours.add(*run_tid3r(args, load))
                disturbance = max(disturbance, meter.cores())
            both = f"original {theirs.seconds[-1]:.2f} s, tid3r {ours.seconds[-1]:.2f} s"
            print(f"round {turn + 1}, {load} {unit}: {both}", file=sys.stderr, flush=True)

    own_version = output_of([str(args.tid3r), "--version"]).strip()
    outputs = "all outputs" if args.all_outputs else "what is used"
    print(f"{args.model}, {args.threads} threads, median of {args.rounds}")
    print(f"original: {version}, f32, all outputs; {own_version}: {args.dtype}, {outputs}\n")
    columns = [f"{unit:>7}", "original", "tid3r", "original / tid3r", "original's memory", "tid3r's memory"]
    print("  ".join(columns))
    for load in args.loads:
        theirs, ours = original[load], tid3r[load]
        cells = [str(load), f"{theirs.median():.2f} s", f"{ours.median():.2f} s"]
        cells += [f"{theirs.median() / ours.median():.2f}", theirs.peak(), ours.peak()]
        print("  ".join(cell.rjust(len(column)) for cell, column in zip(cells, columns)))
    if disturbance > 0.1:
        print(f"\nDo not trust these figures: other work kept up to {disturbance:.1f} cores busy meanwhile.")


def positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise ValueError(text)
    return number


def numbers(text: str) -> list[int]:
    return [positive(number) for number in text.split(",")]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--upstream", type=Path, required=True, help="checkout of the original")
    parser.add_argument("--tid3r", type=Path, required=True, help="the program, built with --release")
    parser.add_argument("--model", choices=MODELS, default="mvdust3r", metavar="NAME", help=", ".join(MODELS))
    parser.add_argument("--load", type=numbers, dest="loads", metavar="N,..", help="photos (4,8), boxes (100) or frames (3)")
    parser.add_argument("--dtype", choices=["f32", "bf16"], default="f32", help="of tid3r's numbers (default: f32)")
    weights = parser.add_mutually_exclusive_group()
    weights.add_argument("--weights", type=Path, metavar="FOLDER", help="weights of tid3r (default: made-up ones)")
    weights.add_argument("--cache", type=Path, metavar="FOLDER", help="where made-up weights stay for the next time")
    parser.add_argument("--threads", type=positive, default=2, help="threads of each side (default: %(default)s)")
    parser.add_argument("--rounds", type=positive, default=3, help="timed runs of each side (default: %(default)s)")
    parser.add_argument("--all-outputs", action="store_true", help="let MV-DUSt3R compute Gaussians and all paths")
    parser.add_argument("--original-alone", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()

    unit, original = MODELS[args.model]
    loads = {"views": [4, 8], "boxes": [100], None: [1]}[unit]
    if original is see3d and unit:
        loads = [3]
    args.loads = args.loads or loads
    least = {"mvdust3r": 2, "mvdust3r-plus": REFERENCES}.get(args.model, 1)
    if min(args.loads) < least:
        parser.error(f"{args.model} needs {least} {unit} or more")
    if unit is None and args.loads != loads:
        parser.error(f"{args.model} has one picture at a time: leave --load out")
    if args.all_outputs and original is not mvdust3r:
        parser.error("--all-outputs is for MV-DUSt3R(+)")
    repository, known_by = UPSTREAM[original]
    if not (args.upstream / known_by).is_file():
        parser.error(f"{args.upstream} is no checkout of {repository}: it has no {known_by}")
    args.upstream, args.tid3r = args.upstream.resolve(), args.tid3r.resolve()
    return args


def main() -> None:
    args = arguments()
    if not args.original_alone:
        return compare(args)
    # The original prints as it is imported.
    with contextlib.redirect_stdout(sys.stderr):
        result = time_original(args.upstream, args.model, args.loads[0], args.threads)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
