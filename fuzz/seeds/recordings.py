"""Recordings of two photos in all layouts."""

import json
import struct
import zlib

from .formats import IDENTITY, LENS, camera_file, colmap, condition, moved, points_ply, transforms
from .pictures import HEIGHT, WIDTH, depth_png, photo_png, photos, png, vast


def recordings():
    """Paths below `recordings` and what is there."""
    photo, depth = photo_png(), depth_png()
    # The depth of this data set has one size.
    large = png([bytes(3 * 256)] * 192, 8, 2, width=256)
    fx, fy, cx, cy = LENS
    matrix = lambda rows: "\n".join(" ".join(map(str, row)) for row in rows).encode()
    files = {}
    for k in (1, 2):
        pose = moved(0.1 * k)
        files |= {
            f"seven_scenes/frame-{k}.color.png": photo, f"seven_scenes/frame-{k}.depth.png": depth, f"seven_scenes/frame-{k}.pose.txt": matrix(pose),
            f"npz/rgb/{k}.png": photo, f"color_depth/color/{k}.png": photo, f"color_depth/depth/{k}.pgm": photos()["plain.pgm"],
            f"scannet/color/{k}.png": photo, f"scannet/depth/{k}.png": depth, f"scannet/pose/{k}.txt": matrix(pose),
            f"tum_freiburg3/rgb/{k}.png": photo, f"tum_freiburg3/depth/{k}.png": depth_png(5),
            f"replica/results/frame{k - 1:06}.png": photo, f"replica/results/depth{k - 1:06}.png": depth_png(6),
            f"nerfstudio/images/{k}.png": photo, f"nerfstudio/depth_{k}.png": depth, f"points/images/{k}.png": photo,
            f"colmap/images/{k}.png": photo, f"colmap_text/images/{k}.png": photo, f"cameras/{k}.png": photo,
            f"dslr/resized_images/{k}.png": photo, f"iphone/rgb/frame_{k - 1:06}.png": large, f"iphone_together/rgb/frame_{k - 1:06}.png": large,
        }
    lens = [[fx, 0, cx, 0], [0, fy, cy, 0], *IDENTITY[2:]]
    stamps = [(10.0 + k, f"{k}.png") for k in (1, 2)]
    files |= {
        "seven_scenes/camera-intrinsics.txt": matrix([row[:3] for row in lens[:3]]), "npz/condition.npz": condition(),
        "color_depth/pose.txt": b"0.1 0 0 0 0 0 1\n0.2 0 0 0 0 0 1\n",
        "scannet/intrinsic/intrinsic_color.txt": matrix(lens), "scannet/intrinsic/intrinsic_depth.txt": matrix(lens),
        "tum_freiburg3/rgb.txt": "".join(f"{t} rgb/{name}\n" for t, name in stamps).encode(),
        "tum_freiburg3/depth.txt": "".join(f"{t + 0.01} depth/{name}\n" for t, name in stamps).encode(),
        "tum_freiburg3/groundtruth.txt": "".join(f"{t} {t / 100} 0 0 0 0 0 1\n" for t, _ in stamps).encode(),
        "replica/traj.txt": "\n".join(" ".join(map(str, sum(moved(0.1 * k), []))) for k in (1, 2)).encode(),
        "replica/cam_params.json": json.dumps({"camera": {"w": WIDTH, "h": HEIGHT, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "scale": 6000}}).encode(),
        "nerfstudio/transforms.json": json.dumps(transforms()).encode(), "points/transforms.json": json.dumps(transforms(False)).encode(),
        "points/cloud.ply": points_ply(-2), "cameras/cameras.json": json.dumps(camera_file()).encode(), "cameras/cloud.ply": points_ply(2),
        "dslr/nerfstudio/transforms.json": json.dumps({**transforms(False, "."), "camera_model": "OPENCV_FISHEYE"}).encode(),
    }
    for folder, text in [("colmap", False), ("colmap_text", True), ("dslr", False)]:
        for name, data in zip(["cameras", "images", "points3D"], colmap(text)):
            within = "colmap" if folder == "dslr" else "sparse/0"
            files[f"{folder}/{within}/{name}.{'txt' if text else 'bin'}"] = data
    of_frame = lambda k: {"aligned_pose": moved(0.1 * k), "intrinsic": [[1680, 0, 959.5], [0, 1680, 719.5], [0, 0, 1]]}
    cameras = json.dumps({f"frame_{k:06}": of_frame(k) for k in (0, 1)}).encode()
    metres = struct.pack("<f", 2.0) * (256 * 192)
    deflate = lambda data: zlib.compress(data, 9, -15)
    framed = lambda data: struct.pack("<I", len(data)) + data
    files |= {"iphone/pose_intrinsic_imu.json": cameras, "iphone_together/pose_intrinsic_imu.json": cameras,
              "iphone/depth.bin": framed(deflate(metres)) * 2, "iphone_together/depth.bin": deflate(metres * 2)}
    return files


def vast_ones():
    """Pictures that state to be large, in the place of others."""
    some = vast()
    found = {f"{key}_{kind}": f"seven_scenes/frame-1.{key}.png".encode() + b"\n" + some[f"vast{kind}.png"]
             for key in ("color", "depth") for kind in ("", "_grey", "_rgb")}
    return {**found, "pgm": b"color_depth/depth/1.pgm\n" + some["vast.pgm"]}


def few_of(files):
    """What decides: texts, arrays, and one picture of each layout."""
    pictures = set()
    for name, data in files.items():
        key = (name.split("/")[0], name.rsplit(".")[-1])
        if name.endswith((".png", ".pgm")):
            if key in pictures:
                continue
            pictures.add(key)
        yield name, data
