"""Files of a scene, requests of the page, lists of scenes."""

import json
import struct

from .checkpoints import safetensors
from .formats import IDENTITY, camera_file, moved
from .pictures import HEIGHT, WIDTH, depths, photo_png, photos, zips


def scene_files():
    """Edits, and files of a frame; the target adds the scene's own."""
    placement = {"by": [0.1, 0, 0], "to": [1, 2], "turn_degrees": 30, "scale": 2}
    camera = {"intrinsics": camera_file()["views"][0]["intrinsics"], "cam_to_world": IDENTITY}
    edits = [
        {"edit": "rename", "instance": 1, "name": "chair"}, {"edit": "remove", "instances": [1]}, {"edit": "keep_only", "instances": [1]},
        {"edit": "move", "instance": 1, "placement": placement}, {"edit": "duplicate", "instance": 1, "copy": 9, "placement": placement},
        {"edit": "recolour", "instances": [1], "change": {"to": {"colour": "#ff8800"}}},
        {"edit": "recolour", "instances": [2], "change": {"adjust": {"hue_degrees": 90, "saturation": 0.5, "value": 1.5}}},
        {"edit": "merge", "instance": 1, "others": [2], "name": "both"}, {"edit": "restyle", "style": "a"},
        *({"edit": "split", "instance": 1, "by": by, "parts": [7]} for by in splits(camera)),
    ]
    lists = {f"edits{k}": json.dumps([edit]).encode() for k, edit in enumerate(edits)}
    record = {"id": 1, "name": "a", "points": 9, "score": 0.5, "photos": ["frame-1"], "mean_colour": [1, 2, 3],
              "floor_box": [[0, 1], [0, 1], [0, 1]]}
    found = {name: b"edits.json\n" + data for name, data in lists.items()}
    # Each pair doubles an instance.
    found["copies"] = b"edits.json\n" + json.dumps([edits[4], {"edit": "merge", "instance": 1, "others": [9]}] * 30).encode()
    found["timings"] = b"timings.json\n" + json.dumps({"clean_seconds": 0.5}).encode()
    found["instances"] = b"instances.json\n" + json.dumps([record]).encode()
    found["colour"] = b"frames/frame-1/colour.png\n" + photo_png()
    ids = struct.pack("<192I", *([1] * 192))
    found["labels"] = b"frames/frame-1/instances.safetensors\n" + safetensors({"map": ("U32", [HEIGHT, WIDTH], ids)})
    found["masks"] = b"frames/frame-1/masks.safetensors\n" + safetensors({"map": ("U32", [HEIGHT, WIDTH], ids)})
    found["valid"] = b"frames/frame-1/validity.safetensors\n" + safetensors({"map": ("BOOL", [HEIGHT, WIDTH], b"\1" * 192)})
    metres = struct.pack("<192f", *(d / 1000 for d in depths()))
    found["geometry"] = b"frames/frame-1/geometry.safetensors\n" + safetensors(
        {"depth": ("F32", [HEIGHT, WIDTH], metres), "confidence": ("F32", [HEIGHT, WIDTH], metres)})
    return found


def splits(camera):
    return [{"components": {"gap": 0.1}}, {"clusters": {"count": 2}}, {"above": {"height": 0.1}},
            {"box": {"low": [-1, -1, -1], "high": [0, 1, 1]}}, {"outline": {"camera": camera, "corners": [[0, 0], [8, 0], [8, 12], [0, 12]]}}]


def requests():
    camera = {"intrinsics": camera_file()["views"][0]["intrinsics"], "cam_to_world": IDENTITY}
    placement = {"by": [0.1, 0, 0], "turn_degrees": 30, "scale": 2}
    actions = [
        {"action": "rename", "instance": 1, "name": "chair"}, {"action": "merge", "instance": 1, "others": [2]},
        {"action": "remove", "instances": [1]}, {"action": "keep_only", "instances": [1]}, {"action": "undo"}, {"action": "redo"},
        {"action": "move", "instance": 1, "placement": placement}, {"action": "duplicate", "instance": 1, "placement": {"to": [0, 0]}},
        {"action": "recolour", "instances": [1], "change": {"to": {"colour": "#ff8800"}}}, {"action": "undo_to", "edits": 0},
        {"action": "recolour", "instances": [1, 2], "change": {"adjust": {"hue_degrees": 9, "saturation": 2, "value": 1}}},
        {"action": "split", "instance": 1, "by": "touching"}, *({"action": "split", "instance": 1, "by": {"by": by}} for by in splits(camera)),
    ]
    views = [{"view": camera}, {"photos": ["frame-1", "frame-2"]}, {"path": {"keys": [camera, {**camera, "cam_to_world": moved(0.2)}], "between": 2}},
             {"orbit": {"views": 3}}]
    completions = ["fill", "none", {"see3d": {"quality": "fast", "steps": 4}}]
    edit = [b"POST /api/edits\n" + json.dumps(action).encode() for action in actions]
    wanted = [json.dumps({"cameras": v, "completion": c, "width": 24}).encode() for v in views for c in completions]
    paths = ["", "assets/app.js", "api/scene", "api/cloud/@/0", "api/photos/@/0", "api/labels/@/0", "api/completions", "api/events", "api/export/ply",
             "api/export/glb", "api/export/html", "api/export/cameras", "api/gallery", "api/gallery/1/video", "api/start",
             "api/gallery/1/frame-1/completed", "api/gallery/1/frame-1/projection", "api/jobs/1/preview/0/0", "api/uploads/1/thumbnail"]
    between = b"\n--\n"
    some = {f"edit{k}": one for k, one in enumerate(edit)}
    some |= {f"estimate{k}": b"POST /api/estimate\n" + body for k, body in enumerate(wanted)}
    some |= {f"job{k}": b"POST /api/jobs\n" + body for k, body in enumerate(wanted[:5])}
    some |= {f"get{k}": f"GET /{path}".encode() for k, path in enumerate(paths)}
    some["several"] = between.join([edit[6], edit[7], edit[10], edit[4], edit[5]])
    some["parts"] = between.join([edit[13], edit[1], edit[9]])
    entry = {"title": "a", "request": {"cameras": views[0], "completion": "fill", "width": 24}, "completion": "b",
             "views": [{"name": "view", "photo": 0}]}
    some["entry"] = between.join([b"FILE gallery/0001/request.json\n" + json.dumps(entry).encode(), b"GET /api/gallery",
                                  b"POST /api/gallery/1/continue\nnull", b"GET /api/gallery/1/view/completed"])
    some["file"] = between.join([b"FILE scene.json\n{}", b"GET /api/scene", edit[0], b"FILE instances.json\n[]", edit[1]])
    some["gallery"] = between.join([b"POST /api/gallery/1/continue\nnull", b"POST /api/jobs/1/cancel\nnull", b"DELETE /api/gallery/1\nnull"])
    return some


def uploads(heic):
    between, found = b"\n--\n", {}
    files = {**photos(), "zip": zips()["stored"], "mp4": b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom", **heic}
    for name, data in files.items():
        found[name] = b"POST /api/uploads/" + name.encode() + b"\n" + data
    found["all"] = between.join([found["plain.png"], found["plain.jpg"], b"GET /api/start", b"GET /api/uploads/@/thumbnail",
                                 b"DELETE /api/uploads/@\nnull", b'POST /api/start\n{"segmenter":"graph","dtype":"bf16"}'])
    found["page"] = between.join([b"GET /", b"GET /api/scene", b'POST /api/start\n{"segmenter":"mobilesamv2"}', b"GET /api/gallery"])
    return found


def lists():
    scene = b'[defaults]\ninputs = [2, 3]\ntests = 1\nsize = 64\n\n[[scene]]\nname = "a"\nrecording = "nowhere"\nframes = "0-9:3"\n' \
        b'test_frames = "5"\nlayout = "tum"\nmeasure = ["views"]\ndepth_scale = 1000\n[scene.clouds.pe3r]\npoints = "b.ply"\ncameras = "b.json"\n' \
        b'[[scene]]\nname = "b"\nphotos = ["c"]\n'
    views = {"psnr": 20, "ssim": 0.8, "lpips_alex": 0.1, "lpips_vgg": None}
    row = {"instances": [0.1, 0.2, 0.3], "instances_of_points": None, "depth": [0.1, 0.2, 0.9, 1], "cameras": [1, 1, 1], "views": views}
    result = {"scene": "a", "recipe": "x", "generator": "tid3r", "photos": 3, "placed": 3, "tests": 1, "rows": {"tid3r": row},
              "seconds": {"reconstruct": 1.0, "clean": 0.1, "segment": 2, "render": 3, "all": 7}, "notes": []}
    return {"scenes": scene, "result": json.dumps(result).encode()}
