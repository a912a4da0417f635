"""Geometry in the formats of other programs: NumPy's archives, PLY, COLMAP, `transforms.json`, `cameras.json`, `.sens`."""

import json
import struct
import zipfile
import zlib

from .pictures import ENCODED, HEIGHT, WIDTH, depths, lying_zip, photo_png, pixels, vast, zipped

LENS = [14.0, 14.0, 7.5, 5.5]
IDENTITY = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def moved(metres):
    """A pose that is so far to the right of the first."""
    return [[1, 0, 0, metres], *IDENTITY[1:]]


def npy(shape, values, kind="<f4", fortran=False):
    text = f"{{'descr': '{kind}', 'fortran_order': {fortran}, 'shape': {shape}, }}".ljust(117) + "\n"
    form = "f" if kind == "<f4" else "d"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text.encode() + struct.pack(f"<{len(values)}{form}", *values)


def condition(how=zipfile.ZIP_DEFLATED):
    fx, fy, cx, cy = LENS
    lens = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    metres = [d / 1000 for d in depths()]
    return zipped({
        "intrinsics.npy": npy((2, 3, 3), lens * 2, "<f8"),
        "poses.npy": npy((2, 4, 4), sum(IDENTITY, []) + sum(moved(0.1), [])),
        "depths.npy": npy((2, HEIGHT, WIDTH), metres * 2),
    }, how)


def arrays():
    return {"deflated.npz": condition(), "stored.npz": condition(zipfile.ZIP_STORED),
            "c.npy": npy((2, 3), range(6)), "fortran.npy": npy((2, 3, 2), range(12), "<f8", True), "one.npy": npy("(3,)", [1, 2, 3]),
            "vast.npz": lying_zip("depths.npy", npy((2, 16384, 16384), [0]), 128 + 4 * 2 * 16384**2 - 1)}


def ply(form="ascii", more=""):
    head = f"ply\nformat {form} 1.0\ncomment a\nelement vertex 2\n" + "".join(
        f"property {kind} {name}\n" for kind, name in
        [("float", "x"), ("double", "y"), ("float", "z"), ("uchar", "red"), ("uchar", "green"), ("uchar", "blue"),
         ("float", "nx"), ("float", "ny"), ("float", "nz"), ("float", "confidence"), ("int", "instance")])
    head += "element face 1\nproperty list uchar int vertex_indices\n" + more + "end_header\n"
    if form == "ascii":
        return (head + "1 2 3 4 5 6 0 0 1 0.5 7\n" * 2 + "3 0 1 0\n").encode()
    order = "<" if "little" in form else ">"
    vertex = struct.pack(order + "fdf3B4fi", 1, 2, 3, 4, 5, 6, 0, 0, 1, 0.5, 7)
    return head.encode() + vertex * 2 + struct.pack(order + "B3i", 3, 0, 1, 0)


def clouds():
    forms = ["ascii", "binary_little_endian", "binary_big_endian"]
    before = b"ply\nformat ascii 1.0\nelement camera 1\nproperty list uint float k\nelement vertex 1\nproperty short x\n" \
        b"property ushort y\nproperty char z\nproperty float red\nproperty float green\nproperty float blue\nend_header\n2 1 2\n1 2 3 0.5 1 255\n"
    many = [ply(form).replace(b"vertex 2", b"vertex 4294967295") for form in forms]
    long = ply(forms[1])[:-13] + b"\xff" + ply(forms[1])[-12:]
    return {**{form: ply(form) for form in forms}, "before": before, "many": many[1], "many_words": many[0], "long": long}


def points_ply(depth):
    head = "ply\nformat ascii 1.0\nelement vertex 48\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    points = [(0.2 * (x - 4), 0.2 * (y - 3), depth) for x in range(8) for y in range(6)]
    return (head + "".join(f"{x:.3f} {y:.3f} {z}\n" for x, y, z in points)).encode()


def colmap(text):
    """Cameras, images and points."""
    points = [(0.2 * (x - 4), 0.2 * (y - 3), 2.0) for x in range(8) for y in range(6)]
    if text:
        cameras = f"# cameras\n1 PINHOLE {WIDTH} {HEIGHT} 14 14 8 6\n2 OPENCV {WIDTH} {HEIGHT} 14 14 8 6 0.01 0 0 0\n"
        images = "# images\n1 1 0 0 0 0 0 0 1 1.png\n3 4 1 5.5 6 -1\n2 1 0 0 0 -0.1 0 0 2 2.png\n\n"
        return [cameras.encode(), images.encode(),
                "".join(f"{k} {x:.2f} {y:.2f} {z} 1 2 3 0.5 1 0\n" for k, (x, y, z) in enumerate(points, 1)).encode()]
    camera = lambda id, model, parameters: struct.pack(f"<IiQQ{len(parameters)}d", id, model, WIDTH, HEIGHT, *parameters)
    cameras = struct.pack("<Q", 2) + camera(1, 1, [14, 14, 8, 6]) + camera(2, 4, [14, 14, 8, 6, 0.01, 0, 0, 0])
    image = lambda id, x, name, seen: (struct.pack("<I7dI", id, 1, 0, 0, 0, x, 0, 0, id) + name + b"\0"
        + struct.pack("<Q", len(seen)) + b"".join(struct.pack("<ddQ", *one) for one in seen))
    images = struct.pack("<Q", 2) + image(1, 0, b"1.png", [(3, 4, 1), (5.5, 6, (1 << 64) - 1)]) + image(2, -0.1, b"2.png", [])
    point = lambda k, at: struct.pack("<Q3d3BdQII", k, *at, 1, 2, 3, 0.5, 1, 1, 0)
    return [cameras, images, struct.pack("<Q", len(points)) + b"".join(point(k, at) for k, at in enumerate(points, 1))]


def colmap_models():
    join = lambda text: (b"t" if text else b"b") + b"\n--\n".join(colmap(text))
    few = lambda text, parts: (b"t" if text else b"b") + b"\n--\n".join(parts)
    binary = colmap(False)
    one = struct.pack("<Q", 1) + binary[2][8 : 8 + 59]
    many = [struct.pack("<Q", 1 << 62) + part[8:] for part in binary]
    return {"text": join(True), "binary": join(False), "many": few(False, many), "many_points": few(False, [*binary[:2], many[2]]), "few": few(False, [*binary[:2], one]), "without": few(True, colmap(True)[:2])}


def transforms(depth=True, images="images"):
    frame = lambda k: {"file_path": f"{images}/{k}.png", "transform_matrix": moved(0.1 * k),
                       **({"depth_file_path": f"depth_{k}.png"} if depth else {})}
    fx, fy, cx, cy = LENS
    return {"camera_model": "OPENCV", "fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "w": WIDTH, "h": HEIGHT,
            "k1": 0.01, "k2": 0, "p1": 0, "p2": 0, "depth_unit_scale_factor": 0.001, "ply_file_path": "cloud.ply",
            "applied_transform": IDENTITY[:3], "frames": [frame(1), frame(2)]}


def camera_file():
    fx, fy, cx, cy = LENS
    lens = {"width": WIDTH, "height": HEIGHT, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    return {"scale": "metric", "views": [{"name": "1", "cam_to_world": IDENTITY, "intrinsics": lens},
                                         {"name": "2", "cam_to_world": moved(0.1), "intrinsics": lens}]}


def camera_files():
    fisheye = {**transforms(), "camera_model": "OPENCV_FISHEYE", "k3": 0, "k4": 0}
    ngp = {"camera_angle_x": 1.0, "w": WIDTH, "h": HEIGHT, "frames": [{"file_path": "1.png", "transform_matrix": IDENTITY}]}
    path = {"views": [{"cam_to_world": IDENTITY}, {"cam_to_world": moved(1)}], "steps": 3}
    vast = {**transforms(), "w": 4294967295, "h": 4294967295}
    found = {"transforms": transforms(), "vast": vast, "fisheye": fisheye, "ngp": ngp, "cameras": camera_file(), "path": path}
    return {name: json.dumps(value).encode() for name, value in found.items()}


def sens(colour, depth, side=None):
    """With sides that are no photo's, if that is given."""
    width, height = (side, side) if side else (WIDTH, HEIGHT)
    fx, fy, cx, cy = (x * width / WIDTH for x in LENS)
    lens = struct.pack("<16f", fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    place = struct.pack("<16f", *sum(IDENTITY, []))
    photo = [b"".join(bytes(p) for p in pixels()), vast()["vast.png"] if side else photo_png(), ENCODED["plain.jpg"]][colour]
    units = struct.pack(f"<{WIDTH * HEIGHT}H", *depths())
    units = zlib.compress(units) if depth else units
    head = struct.pack("<IQ", 4, 4) + b"test" + lens + place + lens + place
    head += struct.pack("<6IfQ", colour, depth, width, height, width, height, 1000, 2)
    frame = lambda x: struct.pack("<16f", *sum(moved(x), [])) + struct.pack("<4Q", 1, 2, len(photo), len(units)) + photo + units
    return head + frame(0) + frame(0.1) + struct.pack("<Q", 0)


def sens_files():
    kinds = [(colour, depth) for colour in range(3) for depth in range(2)]
    return {**{f"{colour}{depth}.sens": sens(colour, depth) for colour, depth in kinds},
            **{f"{colour}{depth}_vast.sens": sens(colour, depth, 1 << 14) for colour, depth in kinds}}
