#!/usr/bin/env python3
"""Turns a scene into a recording for the Rerun viewer (https://rerun.io): to_rerun.py TID3R SCENE OUT.rrd

Needs `pip install rerun-sdk plyfile pillow`. Each instance is an entity of its own, each photo a pinhole camera
with its picture. Up is up: all is in the floor's frame."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import rerun
from PIL import Image
from plyfile import PlyData


def log_instance(path):
    vertex = PlyData.read(path)["vertex"]
    stack = lambda names: np.stack([np.asarray(vertex[name]) for name in names], axis=1)
    entity = f"scene/instances/{path.stem}"
    rerun.log(entity, rerun.Points3D(stack("xyz"), colors=stack(["red", "green", "blue"])), static=True)


def log_camera(view, photo):
    pose, lens = np.array(view["cam_to_world"]), view["intrinsics"]
    entity = f"scene/cameras/{view['name']}"
    rerun.log(entity, rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]), static=True)
    # Rerun counts pixels as COLMAP does.
    pinhole = rerun.Pinhole(
        focal_length=[lens["fx"], lens["fy"]],
        principal_point=[lens["cx"] + 0.5, lens["cy"] + 0.5],
        resolution=[lens["width"], lens["height"]],
        camera_xyz=rerun.ViewCoordinates.RDF,
    )
    rerun.log(entity, pinhole, static=True)
    with Image.open(photo) as picture:
        rerun.log(entity, rerun.Image(picture.convert("RGB")).compress(), static=True)


def main():
    program, scene, out = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for target in [["cameras.json"], ["parts", "--format", "instances"], ["data/transforms.json"]]:
            subprocess.run([program, "export", scene, "-o", folder / target[0], *target[1:]], check=True)
        rerun.init("tid3r")
        rerun.save(out)
        for path in sorted((folder / "parts").iterdir()):
            log_instance(path)
        transforms = json.loads((folder / "data/transforms.json").read_text())
        to_floor = np.array(transforms["applied_transform"])
        rerun.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        rerun.log("scene", rerun.Transform3D(translation=to_floor[:, 3], mat3x3=to_floor[:, :3]), static=True)
        views = json.loads((folder / "cameras.json").read_text())["views"]
        for frame, view in zip(transforms["frames"], views):
            log_camera(view, folder / "data" / frame["file_path"])


if __name__ == "__main__":
    main()
