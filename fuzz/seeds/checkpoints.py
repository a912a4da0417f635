"""Tensors in safetensors files, and in files of `torch.save` that are made without PyTorch."""

import io
import json
import pickle
import struct

from .pictures import zipped


def safetensors(tensors, metadata=None):
    head, body = ({"__metadata__": metadata} if metadata else {}), b""
    for name, (kind, shape, data) in tensors.items():
        head[name] = {"dtype": kind, "shape": shape, "data_offsets": [len(body), len(body) + len(data)]}
        body += data
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + body


def tensor_files():
    maps = {"map": ("F32", [2, 3], bytes(24)), "depth": ("U32", [2, 1], bytes(8)), "confidence": ("BOOL", [1, 3], b"\0\1\1")}
    halves = {"a.weight": ("F16", [2, 2], bytes(8)), "a.bias": ("BF16", [3], bytes(6)), "b": ("I64", [], bytes(8))}
    vast = struct.pack("<Q", 1 << 62) + safetensors({})[8:]
    far = safetensors({"map": ("F32", [1 << 31, 1 << 30], bytes(8))})
    return {"vast": vast, "far": far, "maps": safetensors(maps, {"recipe": "x"}), "halves": safetensors(halves), "none": safetensors({})}


class Callable:
    """Pickled as a call of something that there need not be here."""

    def __init__(self, module, name, arguments, state=None):
        self.module, self.name, self.arguments, self.state = module, name, arguments, state


class Storage:
    def __init__(self, kind, key, count):
        self.parts = (kind, key, count)


class Pickler(pickle._Pickler):
    """Python's own, of the kind whose parts can be replaced."""

    def save(self, thing, save_persistent_id=True):
        if isinstance(thing, Storage):
            kind, key, count = thing.parts
            self.save(("storage", Callable("torch", kind, None), key, "cpu", count))
            return self.write(pickle.BINPERSID)
        if isinstance(thing, Callable):
            self.write(pickle.GLOBAL + f"{thing.module}\n{thing.name}\n".encode())
            if thing.arguments is not None:
                self.save(thing.arguments)
                self.write(pickle.REDUCE)
            if thing.state is not None:
                self.save(thing.state)
                self.write(pickle.BUILD)
            return None
        return super().save(thing, save_persistent_id)


def pickled(thing, protocol=2):
    out = io.BytesIO()
    Pickler(out, protocol).dump(thing)
    return out.getvalue()


def tensor(shape, strides, kind="FloatStorage", offset=0, count=16):
    ordered = Callable("collections", "OrderedDict", ())
    return Callable("torch._utils", "_rebuild_tensor_v2", (Storage(kind, "0", count), offset, shape, strides, False, ordered))


def pickles():
    state = {"a.weight": tensor((2, 3), (3, 1)), "a.bias": tensor((4,), (1,), "HalfStorage", 2, 32)}
    parameter = Callable("torch._utils", "_rebuild_parameter", (tensor((2,), (1,)), True, Callable("collections", "OrderedDict", ())))
    module = lambda inside, parts: Callable("net", "Part", (), {"_parameters": parts, "_buffers": {}, "_modules": inside})
    network = module({"0": module({}, {"weight": parameter, "bias": None})}, {})
    named = {"epoch": 3, "args": Callable("argparse", "Namespace", (), {"model": "Net(a=1, b=('exp', -inf, inf), c={'skip': True})"})}
    things = [1, -5, 1 << 70, 0.5, "é", b"x", None, True, (), (1,), [1, 2], {"a": {1, 2}}, frozenset([3]), "a" * 300]
    found = {"state": state, "model": {"model": state, **named}, "network": {"ema": None, "model": network}, "nested": {"a": {"b": tensor((), ())}},
             "strided": {"a": tensor((3, 2), (1, 3), "BFloat16Storage")}, "things": {"x": things, "state_dict": state}}
    made = {name: pickled(thing) for name, thing in found.items()}
    made.update({f"protocol{k}": pickle.dumps({"a": things}, k) for k in (2, 3, 4, 5)})
    return made


def checkpoints():
    whole = {f"{name}.pth": zipped({"a/data.pkl": data, "a/byteorder": b"little", "a/data/0": bytes(64), "a/version": b"3\n"})
             for name, data in pickles().items() if name in ("state", "network")}
    data = {"a.weight": tensor((2, 3), (3, 1))}
    legacy = [pickled(0x1950A86A20F9469CFC6C), pickled(1001), pickled({"protocol_version": 1001, "little_endian": True}),
              pickled(data), pickled(["0"]), struct.pack("<Q", 16) + bytes(64)]
    index = {"metadata": {"total_size": 8}, "weight_map": {"a.weight": "part.safetensors", "b": "part.safetensors"}}
    manifest = {"state_dict": {"b.bias": {"shape": [3], "dtype": "float32"}}}
    return {**whole, "legacy.pth": b"".join(legacy), "index.json": json.dumps(index).encode(),
            "manifest.json": json.dumps(manifest).encode(), **tensor_files()}
