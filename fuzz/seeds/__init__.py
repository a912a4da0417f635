"""What fuzzing begins with: small whole files of every format, made by formulas."""

import shutil
from pathlib import Path

from .checkpoints import checkpoints, pickles, tensor_files
from .dictionaries import WORDS, quoted
from .formats import arrays, camera_files, clouds, colmap_models, sens_files
from .page import lists, requests, scene_files, uploads
from .pictures import exif, photos, vast, zips
from .recordings import few_of, recordings, vast_ones

FIXTURES = Path(__file__).resolve().parents[2] / "tests/fixtures"
# In longer files, mutations would be lost.
LONGEST = 4000


def fixtures(pattern):
    paths = (path for path in sorted(FIXTURES.glob(pattern)) if path.stat().st_size <= LONGEST)
    return {path.parent.name + path.suffix: path.read_bytes() for path in paths}


def headed(files):
    """Files behind a line with their names."""
    return {name.replace("/", "_"): name.encode() + b"\n" + data for name, data in files.items()}


def beside_weights():
    """What is published beside See3D's weights, in small."""
    root = FIXTURES / "cases/see3d/tiny_repo"
    paths = (path for ending in ("json", "txt") for path in sorted(root.rglob(f"*.{ending}")))
    return {str(path.relative_to(root)): path.read_bytes() for path in paths}


def make(folder):
    """Writes all anew into `folder`: `TARGET/*` and `TARGET.dict`, and `recordings/LAYOUT`, of which targets change one file
    at a time. Gives the names of the targets."""
    whole, heic = recordings(), fixtures("heic/*.heic")
    targets = {
        "ply": clouds(), "colmap": colmap_models(), "cameras": camera_files(), "sens": sens_files(), "recording": {**headed(dict(few_of(whole))), **vast_ones()},
        "npz": arrays(), "photo": {**photos(), **vast()}, "exif": {"little": exif("<"), "big": exif(">")}, "heic": heic, "zip": zips(),
        "safetensors": {**tensor_files(), **fixtures("cases/*/*/inputs.safetensors")}, "pickle": pickles(), "checkpoint": checkpoints(),
        # The targets add all networks.
        "config": {"none": b"{}"}, "network": {"none": b"a 1\n"}, "repository": headed(beside_weights()),
        "scene": scene_files(), "list": lists(), "api": requests(), "uploads": uploads(heic),
    }
    write = {f"{target}/{name}": data for target, files in targets.items() for name, data in files.items()}
    write |= {f"recordings/{name}": data for name, data in whole.items()}
    write |= {f"{target}.dict": "".join(f'"{quoted(word)}"\n' for word in words.split(" ")).encode() for target, words in WORDS.items()}
    shutil.rmtree(folder, ignore_errors=True)
    for name, data in write.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return list(targets)
