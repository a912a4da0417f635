"""Photos of a gradient, and depth of a wall that recedes to the right, in all formats; and archives of them."""

import io
import struct
import zipfile
import zlib
from pathlib import Path

WIDTH, HEIGHT = 16, 12
# What needs an encoder: the gradient of `pixels`, by Pillow.
ENCODED = {path.name: path.read_bytes() for path in sorted((Path(__file__).parent / "encoded").iterdir())}


def pixels():
    return [(16 * x, 20 * y, 8 * (x + y)) for y in range(HEIGHT) for x in range(WIDTH)]


def depths():
    """Millimetres: a wall that recedes to the right."""
    return [2000 + 40 * x for y in range(HEIGHT) for x in range(WIDTH)]


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(rows, depth, colour, extra=b"", width=WIDTH):
    head = struct.pack(">IIBBBBB", width, len(rows), depth, colour, 0, 0, 0)
    body = zlib.compress(b"".join(b"\0" + row for row in rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + extra + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def rows_of(values):
    return [values[k : k + WIDTH] for k in range(0, WIDTH * HEIGHT, WIDTH)]


def photo_png(extra=b""):
    return png([b"".join(bytes(p) for p in row) for row in rows_of(pixels())], 8, 2, extra)


def depth_png(scale=1.0):
    return png([struct.pack(f">{WIDTH}H", *(int(scale * d) for d in row)) for row in rows_of(depths())], 16, 0)


def exif(order="<"):
    """Turned, and taken with 24 mm by the measure of 35 mm film; with what a sensor's density says, too."""
    short = lambda tag, value: struct.pack(order + "HHI", tag, 3, 1) + struct.pack(order + "HH", value, 0)
    long = lambda tag, kind, value: struct.pack(order + "HHII", tag, kind, 1, value)
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    first = struct.pack(order + "H", 2) + short(0x112, 6) + long(0x8769, 4, 38) + bytes(4)
    within = struct.pack(order + "H", 6) + short(0xA405, 24) + long(0x920A, 5, 116) + long(0xA20E, 5, 124)
    within += short(0xA210, 3) + short(0xA002, WIDTH) + short(0xA003, HEIGHT) + bytes(4)
    return head + first + within + struct.pack(order + "4I", 5, 1, 2540, 1)


def tiff():
    strip = b"".join(bytes(p) for p in pixels())
    entries = [(256, 3, WIDTH), (257, 3, HEIGHT), (258, 3, 8), (259, 3, 1), (262, 3, 2), (273, 4, 200), (277, 3, 3),
               (278, 3, HEIGHT), (279, 4, len(strip))]
    ifd = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries)
    return (b"II*\0" + struct.pack("<I", 8) + ifd + bytes(4)).ljust(200, b"\0") + strip


def photos():
    found = dict(ENCODED)
    jpeg = found["plain.jpg"]
    block = b"Exif\0\0" + exif()
    found["turned.jpg"] = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 2) + block + jpeg[2:]
    found["plain.png"], found["turned.png"] = photo_png(), photo_png(chunk(b"eXIf", exif()))
    found["grey.png"], found["deep.png"] = png([bytes(range(WIDTH))] * HEIGHT, 8, 0), depth_png()
    found["palette.png"] = png([bytes(WIDTH)] * HEIGHT, 8, 3, chunk(b"PLTE", bytes(range(48))))
    found["plain.tiff"] = tiff()
    plain = b"".join(bytes(p) for p in pixels())
    found["plain.ppm"] = b"P6 %d %d 255\n" % (WIDTH, HEIGHT) + plain
    found["text.ppm"] = b"P3\n# text\n2 1 255\n1 2 3 4 5 6\n"
    found["plain.pgm"] = b"P5 %d %d 65535\n" % (WIDTH, HEIGHT) + struct.pack(f">{WIDTH * HEIGHT}H", *depths())
    found["bits.pbm"] = b"P4 16 2\n\x55\xaa\xf0\x0f"
    found["any.pam"] = b"P7\nWIDTH 2\nHEIGHT 1\nDEPTH 3\nMAXVAL 255\nTUPLTYPE RGB\nENDHDR\n123456"
    return found


def vast():
    """Small files of pictures that state to be of 16384 x 16384 deep pixels."""
    side, body = 1 << 14, zlib.compress(bytes(1000))
    head = lambda depth, colour: chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, depth, colour, 0, 0, 0))
    made = lambda depth, colour: b"\x89PNG\r\n\x1a\n" + head(depth, colour) + chunk(b"IDAT", body) + chunk(b"IEND", b"")
    tags = [(256, 4, side), (257, 4, side), (258, 3, 32), (259, 3, 1), (262, 3, 2), (273, 4, 300), (277, 3, 4), (278, 4, side),
            (279, 4, 0xFFFFFFFF), (339, 3, 3)]
    ifd = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    return {"vast.png": made(16, 6), "vast_grey.png": made(16, 0), "vast_bits.png": made(1, 0), "vast_rgb.png": made(8, 2),
            "vast.ppm": b"P6 16384 16384 65535\n" + bytes(10), "vast.pgm": b"P5 16384 16384 65535\n" + bytes(10),
            "vast.tiff": (b"II*\0" + struct.pack("<I", 8) + ifd).ljust(400, b"\0"),
            "vast.webp": b"RIFF\x12\0\0\0WEBPVP8L\x06\0\0\0\x2f\xff\xff\xff\x0f\0"}


def zipped(files, how=zipfile.ZIP_STORED):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", how) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, how)
    return out.getvalue()


def lying_zip(name, data, size):
    """An archive of one file as it is, whose directory states another size."""
    made = bytearray(zipped({name: data}))
    for begin, at in ((b"PK\x03\x04", 18), (b"PK\x01\x02", 20)):
        found = made.index(begin) + at
        made[found : found + 8] = struct.pack("<II", size, size)
    return bytes(made)


def zips():
    some = {"a/1.png": photo_png(), "a/2.jpg": ENCODED["plain.jpg"], "notes.txt": b"no photo"}
    return {"stored": zipped(some), "deflated": zipped(some, zipfile.ZIP_DEFLATED), "empty": zipped({}),
            "vast": lying_zip("1.png", photo_png(), 0x1FFFFFFF),
            "names": zipped({"../1.png": photo_png(), "__MACOSX/1.png": b"", "c:\\1.png": photo_png()})}
