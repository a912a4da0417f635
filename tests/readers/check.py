#!/usr/bin/env python3
"""Exports a scene in all formats and opens the files with other people's readers; see README.md."""

import argparse
import io
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import open3d
import pycolmap
import pygltflib
import trimesh
from PIL import Image
from plyfile import PlyData
from rerun.chunk import RrdReader
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
failures = 0
edited = False


def check(what, holds, figure=""):
    global failures
    failures += not holds
    print(f"  {'ok  ' if holds else 'FAIL'} {what} {figure}")


def near(what, got, want, tolerance):
    got, want = np.asarray(got, float), np.asarray(want, float)
    error = np.abs(got - want).max() if got.shape == want.shape and got.size else np.inf
    check(what, error <= tolerance, f"(off by at most {error:.2g})")


def vertices(path):
    return PlyData.read(path)["vertex"]


def columns(vertex, names):
    return np.stack([np.asarray(vertex[name]) for name in names.split()], axis=1)


def in_order(rows):
    return rows[np.lexsort(np.round(rows[:, :3], 5).T)]


class Cloud:
    """What the plain PLY says: the yardstick for all that have points."""

    def __init__(self, path):
        vertex = vertices(path)
        self.xyz = columns(vertex, "x y z").astype(float)
        self.rgb = columns(vertex, "red green blue")
        self.ids = np.asarray(vertex["instance"])


def check_ply(path, cloud):
    print(f"PLY: {len(cloud.xyz)} points, {len(set(cloud.ids)) - 1} instances")
    mesh = trimesh.load(path)
    near("trimesh: positions", mesh.vertices, cloud.xyz, 0)
    near("trimesh: colours", np.asarray(mesh.colors)[:, :3], cloud.rgb, 0)
    points = open3d.io.read_point_cloud(str(path))
    near("Open3D: positions", points.points, cloud.xyz, 0)
    near("Open3D: colours", np.asarray(points.colors) * 255, cloud.rgb, 1e-4)


def check_parts(folder, cloud):
    files = sorted(folder.iterdir())
    print(f"PLY for each instance: {len(files)} files")
    count = 0
    for path in files:
        ids = set(np.asarray(vertices(path)["instance"]))
        count += len(vertices(path)["x"])
        if ids != {int(path.name.split("-")[0])}:
            check(f"{path.name} has its own points only", False)
    check("all points are in one of them", count == len(cloud.xyz))


def check_glb(path, cloud, cameras):
    gltf = pygltflib.GLTF2().load(str(path))
    clouds = [node for node in gltf.nodes if node.mesh is not None]
    print(f"GLB: {len(clouds)} clouds, {len(gltf.cameras)} cameras")
    ids = sorted(node.extras["id"] for node in clouds)
    check("pygltflib: a node for each instance", ids == sorted(set(cloud.ids.tolist())))
    root = np.array(gltf.nodes[0].matrix).reshape(4, 4).T
    by_name = {node.name: node for node in gltf.nodes if node.camera is not None}
    for view in cameras["views"]:
        node, lens = by_name[view["name"]], view["intrinsics"]
        near(f"pose of {view['name']}", np.array(node.matrix).reshape(4, 4).T,
             np.array(view["cam_to_world"]) @ OPENGL, 1e-6)
        perspective = gltf.cameras[node.camera].perspective
        near(f"lens of {view['name']}", [perspective.yfov, perspective.aspectRatio],
             [2 * np.arctan(lens["height"] / 2 / lens["fy"]),
              lens["width"] / lens["fx"] / (lens["height"] / lens["fy"])], 1e-9)

    scene = trimesh.load(path)
    xyz, rgb = [], []
    for name in scene.graph.nodes_geometry:
        transform, geometry = scene.graph[name]
        points = scene.geometry[geometry]
        xyz.append(trimesh.transform_points(points.vertices, transform))
        rgb.append(np.asarray(points.colors)[:, :3].astype(float))
    xyz, rgb = np.concatenate(xyz), np.concatenate(rgb)
    want = trimesh.transform_points(cloud.xyz, root)
    check("trimesh: all points", len(xyz) == len(want), len(xyz))
    near("trimesh: positions, y up", in_order(xyz), in_order(want), 1e-3)
    low, high = np.percentile(xyz[:, 1], [1, 99])
    print(f"       heights (1 % and 99 %): {low:.2f} to {high:.2f}")

    # Colours as numbers: trimesh makes 8 bits of them.
    blob, colours, positions, bounds = gltf.binary_blob(), [], [], 0
    for node in clouds:
        attributes = gltf.meshes[node.mesh].primitives[0].attributes
        for index, dtype, width, into in [(attributes.COLOR_0, "<u2", 4, colours),
                                          (attributes.POSITION, "<f4", 3, positions)]:
            accessor = gltf.accessors[index]
            view = gltf.bufferViews[accessor.bufferView]
            values = np.frombuffer(blob, dtype, accessor.count * width, view.byteOffset)
            into.append(values.reshape(-1, width))
        bounds += np.abs(np.array([accessor.min, accessor.max])
                         - [positions[-1].min(0), positions[-1].max(0)]).max()
    near("bounds that are stated", bounds, 0, 1e-6)
    light = np.concatenate(colours)[:, :3] / 65535
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    order = np.argsort(cloud.ids, kind="stable")
    near("linear colours lead back to sRGB", np.round(srgb * 255), cloud.rgb[order], 0)
    near("positions, in the scene's frame", np.concatenate(positions), cloud.xyz[order], 0)


def check_colmap(folder, cloud, cameras, photos):
    model = pycolmap.Reconstruction(str(folder / "sparse/0"))
    print(f"COLMAP: {model.num_images()} images, {model.num_points3D()} points")
    check("as many images as cameras", model.num_images() == len(cameras["views"]))
    by_stem = {Path(image.name).stem: image for image in model.images.values()}
    for view in cameras["views"]:
        lens = view["intrinsics"]
        image = next(image for stem, image in by_stem.items() if view["name"].startswith(stem))
        camera = model.cameras[image.camera_id]
        near(f"lens of {image.name}", camera.params,
             [lens["fx"], lens["fy"], lens["cx"] + 0.5, lens["cy"] + 0.5], 1e-9)
        pose = np.linalg.inv(np.array(view["cam_to_world"]))[:3]
        near(f"pose of {image.name}", image.cam_from_world().matrix(), pose, 1e-6)
        if photos:
            with Image.open(folder / "images" / image.name) as photo:
                check("size of the photo", photo.size == (camera.width, camera.height))
    errors, lengths = [], []
    for point in model.points3D.values():
        lengths.append(point.track.length())
        for element in point.track.elements:
            image = model.images[element.image_id]
            pixel = image.points2D[element.point2D_idx]
            if pixel.point3D_id not in model.points3D:
                check("an observation is of a point", False)
            projected = model.cameras[image.camera_id].img_from_cam(image.cam_from_world() * point.xyz)
            errors.append(np.linalg.norm(projected - pixel.xy))
    check("reprojection", max(errors) < 1e-2, f"(off by at most {max(errors):.2g} pixels)")
    print(f"       points are seen by {np.mean(lengths):.2f} photos on the average")
    xyz = np.array([point.xyz for point in model.points3D.values()])
    rgb = np.array([point.color for point in model.points3D.values()])
    distance, nearest = cKDTree(cloud.xyz).query(xyz)
    check("points are the cloud's", distance.max() == 0)
    same = (cloud.rgb[nearest] == rgb).all(axis=1).mean()
    check("so are colours, but for points in one place", same > 0.99, f"({same:.1%})")


def unprojected(depth, lens, cam_to_world, half):
    v, u = np.nonzero(depth)
    z = depth[v, u]
    x = (u + half - lens["cx"]) / lens["fx"] * z
    y = (v + half - lens["cy"]) / lens["fy"] * z
    return np.stack([x, y, z], axis=1) @ cam_to_world[:3, :3].T + cam_to_world[:3, 3]


def check_unprojected(what, points, xyz, tolerance):
    """Depth must lie on the cloud: all of it, unless edits have moved points, which leave it alone."""
    some = points[:: max(1, len(points) // 20000)]
    distance, _ = cKDTree(xyz).query(some)
    on = (distance < tolerance).mean()
    check(what, on > (0.3 if edited else 0.999), f"({on:.1%} within {tolerance:.2g})")


def check_transforms(path, cloud, cameras):
    file = json.loads(path.read_text())
    frames = file["frames"]
    print(f"transforms.json: {len(frames)} frames")
    applied = np.vstack([file["applied_transform"], [0, 0, 0, 1]])
    xyz = columns(vertices(path.parent / file["ply_file_path"]), "x y z").astype(float)
    near("cloud, by applied_transform", xyz, cloud.xyz @ applied[:3, :3].T + applied[:3, 3], 1e-3)
    for frame, view in zip(frames, cameras["views"]):
        lens = view["intrinsics"]
        ours = {key: frame.get(key, file.get(key)) for key in "w h fl_x fl_y cx cy".split()}
        want = [lens["width"], lens["height"], lens["fx"], lens["fy"], lens["cx"] + 0.5, lens["cy"] + 0.5]
        near(f"lens of {frame['file_path']}", list(ours.values()), want, 1e-9)
        pose = np.array(frame["transform_matrix"])
        near(f"pose of {frame['file_path']}", pose, applied @ np.array(view["cam_to_world"]) @ OPENGL, 1e-6)
        with Image.open(path.parent / frame["file_path"]) as photo:
            check("size of the photo", photo.size == (lens["width"], lens["height"]))
        unit = file["depth_unit_scale_factor"]
        depth = np.array(Image.open(path.parent / frame["depth_file_path"])).astype(float) * unit
        # As nerfstudio does it: pixel centres at + 0.5, lens scaled to the map. A map whose pixels are not
        # the scene's frame's is off by up to half a pixel.
        x, y = depth.shape[1] / ours["w"], depth.shape[0] / ours["h"]
        scaled = {"fx": ours["fl_x"] * x, "fy": ours["fl_y"] * y, "cx": ours["cx"] * x, "cy": ours["cy"] * y}
        points = unprojected(depth, scaled, pose @ OPENGL, 0.5)
        pixels = 0 if (x, y) == (1, 1) else 0.75
        check_unprojected("depth lies on the cloud", points, xyz, 2 * unit + pixels * depth.max() / scaled["fx"])


def check_maps(folder, cloud):
    description = json.loads((folder / "depth.json").read_text())
    print(f"depth: {len(description['frames'])} photos, unit {description['depth_unit']:.3g}, "
          f"{description['scale']}")
    for view in description["frames"]:
        archive = np.load(folder / f"{view['name']}.npz")
        lens = view["intrinsics"]
        near("intrinsics", archive["intrinsics"],
             [[lens["fx"], 0, lens["cx"]], [0, lens["fy"], lens["cy"]], [0, 0, 1]], 0)
        near("cam_to_world", archive["cam_to_world"], view["cam_to_world"], 0)
        for name in ["depth", "confidence"]:
            png = np.array(Image.open(folder / f"{view['name']}.{name}.png")).astype(float)
            unit = description[f"{name}_unit"]
            near(f"{name} of {view['name']}", png * unit, archive[name], 0.51 * unit + 1e-6)
        points = unprojected(archive["depth"].astype(float), lens, archive["cam_to_world"], 0)
        check_unprojected("depth lies on the cloud", points, cloud.xyz, 1e-4 * np.abs(points).max())


def check_splats(path, cloud):
    vertex = vertices(path)
    print(f"splats: {len(vertex['x'])}")
    near("positions", columns(vertex, "x y z"), cloud.xyz, 0)
    rgb = 0.5 + 0.28209479177387814 * columns(vertex, "f_dc_0 f_dc_1 f_dc_2")
    near("colours", rgb * 255, cloud.rgb, 1e-3)
    opacity = 1 / (1 + np.exp(-np.asarray(vertex["opacity"])))
    extent = np.exp(columns(vertex, "scale_0 scale_1 scale_2"))
    rotation = columns(vertex, "rot_0 rot_1 rot_2 rot_3")
    near("rotations have length 1", np.linalg.norm(rotation, axis=1), np.ones(len(rotation)), 1e-5)
    check("opacities", (opacity > 0).all() and (opacity <= 1).all(),
          f"({opacity.min():.3g} to {opacity.max():.3g})")
    check("extents", np.isfinite(extent).all() and (extent > 0).all(),
          f"({extent.min():.3g} to {extent.max():.3g})")


class Entities:
    """The entities of a recording, loaded by what its footer says; components are NumPy arrays or lists."""

    def __init__(self, path):
        self.tables = {str(chunk.entity_path): chunk.to_record_batch()
                       for chunk in RrdReader(path).store().stream()}

    def __call__(self, path, component):
        values = self.tables[path][component][0].values
        return values.to_pylist()

    def numbers(self, path, component):
        return np.array(self(path, component))

    def pose(self, path):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat(self.numbers(path, "Transform3D:quaternion")[0]).as_matrix()
        pose[:3, 3] = self.numbers(path, "Transform3D:translation")[0]
        return pose


def check_lens(what, entities, path, lens):
    near(f"lens of {what}", entities.numbers(path, "Pinhole:image_from_camera").reshape(3, 3).T,
         [[lens["fx"], 0, lens["cx"] + 0.5], [0, lens["fy"], lens["cy"] + 0.5], [0, 0, 1]],
         1e-6 * lens["width"])
    near(f"size of {what}", entities.numbers(path, "Pinhole:resolution")[0], [lens["width"], lens["height"]], 0)


def check_rrd(path, cloud, cameras, names, applied, maps):
    verified = subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", path], capture_output=True, text=True)
    entities = Entities(path)
    points = {path: table for path, table in entities.tables.items() if path.startswith("/scene/instances/")}
    print(f"Rerun: {len(entities.tables)} entities, {len(points)} of them points")
    check("rerun rrd verify", verified.returncode == 0, verified.stderr.strip())
    check("z is up", entities("/", "ViewCoordinates:xyz") == [[3, 5, 1]])
    near("the scene stands upright", entities.pose("/scene"), np.vstack([applied, [0, 0, 0, 1]]), 1e-6)
    classes = [pair["class_description"]["info"] for pair in entities("/scene", "AnnotationContext:context")[0]]
    check("names of classes", {info["id"]: info["label"] for info in classes if info["id"]} == names)
    check("each has an entity", sorted(entities(path, "Points3D:class_ids")[0] for path in points)
          == sorted(info["id"] for info in classes))
    by_class = sorted(points, key=lambda path: entities(path, "Points3D:class_ids"))
    order = np.argsort(cloud.ids, kind="stable")
    xyz, rgba = (np.concatenate([entities.numbers(path, f"Points3D:{field}") for path in by_class])
                 for field in ["positions", "colors"])
    near("positions", xyz, cloud.xyz[order], 0)
    rgb = np.stack([rgba >> 24, rgba >> 16 & 255, rgba >> 8 & 255], axis=1)
    near("colours", rgb, cloud.rgb[order], 0)
    for view in cameras["views"]:
        at = f"/scene/cameras/{view['name']}"
        near(f"pose of {view['name']}", entities.pose(at), view["cam_to_world"], 1e-5)
        check_lens(view["name"], entities, f"{at}/photo", view["intrinsics"])
        check("axes", entities(f"{at}/photo", "Pinhole:camera_xyz") == [[3, 2, 5]])
        file = bytes(entities(f"{at}/photo", "EncodedImage:blob")[0])
        with Image.open(io.BytesIO(file)) as photo:
            size = (view["intrinsics"]["width"], view["intrinsics"]["height"])
            kind = entities(f"{at}/photo", "EncodedImage:media_type")
            check("the photo", photo.size == size and [photo.get_format_mimetype()] == kind)
    for view in json.loads((maps / "depth.json").read_text())["frames"]:
        at = f"/scene/cameras/{view['name']}/depth"
        check_lens(f"depth of {view['name']}", entities, at, view["intrinsics"])
        depth = np.array(entities(at, "DepthImage:buffer")[0], np.uint8).view("<f4")
        near("depth", depth, np.load(maps / f"{view['name']}.npz")["depth"].ravel(), 0)
        check("in the scene's units", entities(at, "DepthImage:meter") == [1])


def main():
    global edited
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tid3r", help="the program")
    parser.add_argument("scene", help="a scene that has been cleaned")
    arguments = parser.parse_args()
    program = Path(arguments.tid3r).resolve()
    edits = subprocess.run([program, "edit", arguments.scene, "list", "--json"], capture_output=True, text=True)
    edited = edits.returncode == 0 and bool(json.loads(edits.stdout))
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)

        def export(name, *options, must=True):
            out = folder / name
            command = [program, "export", arguments.scene, "-o", out, *options]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode and must:
                sys.exit(f"{name}: {done.stderr}")
            return None if done.returncode else out

        ply = export("room.ply")
        cloud = Cloud(ply)
        cameras = json.loads(export("cameras.json").read_text())
        check_ply(ply, cloud)
        check_parts(export("parts", "--format", "instances"), cloud)
        check_glb(export("room.glb"), cloud, cameras)
        few = ["--max-points", "20000"]
        check_colmap(export("colmap", "--format", "colmap", *few), cloud, cameras, True)
        check_colmap(export("text", "--format", "colmap-text", "--no-photos", *few), cloud, cameras, False)
        transforms, maps = export("data/transforms.json", "--depth"), export("maps", "--format", "depth")
        check_transforms(transforms, cloud, cameras)
        check_maps(maps, cloud)
        recording = export("room.rrd", "--depth", must=False)
        if recording:
            listed = subprocess.run([program, "instances", "list", arguments.scene, "--json"],
                                    capture_output=True, text=True)
            instances = json.loads(listed.stdout)["instances"] if listed.returncode == 0 else []
            names = {instance["id"]: instance["name"] for instance in instances}
            applied = json.loads(transforms.read_text())["applied_transform"]
            check_rrd(recording, cloud, cameras, names, applied, maps)
        else:
            print("Rerun: not with this build of tid3r (--features rerun)")
        splats = export("room.splats.ply", must=False)
        if splats:
            check_splats(splats, cloud)
        else:
            print("splats: the scene has no Gaussians")
    print("all is well" if not failures else f"{failures} checks failed")
    sys.exit(failures > 0)


if __name__ == "__main__":
    main()
