"""Compares overcam's markers with AprilTag 3 and ArUco on plates of the same size, and prints a table in Markdown.

All plates are drawn here, by a renderer that shares nothing with overcam: each kind of marker lies flat on the same grey floor, at
random places and turns, seen through the same lens (Gaussian blur) with the same noise. A plate is all that must be printed: the
tag with the white border that its detector asks for.

    pip install numpy opencv-contrib-python-headless pupil-apriltags
    cargo build --release
    python3 tests/peers/compare.py target/release/overcam markers --frames 20

Recall is the share of plates whose name was read at the right place; errors are root mean squares over those. Each detector runs with
settings that favour accuracy (no decimation, refined edges or corners). What a detector calls the middle of a pixel, or the
direction "up", is its own affair: a constant offset of half a pixel or a quarter turn is taken off. The AprilTag package has been
seen to crash once in a dozen runs; run it again.
"""

import argparse
import json
import math
import pathlib
import re
import subprocess
import sys
import tempfile

import cv2
import numpy as np
import pupil_apriltags

WIDTH, HEIGHT = 640, 480
FLOOR, PAPER, INK = 120.0, 225.0, 40.0
TEXTURE = 1200  # pixels of a plate's drawing
FINE = 8  # points of a pixel along each axis
PER_FRAME = 13  # plates of a frame
COLUMNS, ROWS = 5, 3


def outline(path):
    """Corners of the one absolute SVG path of a drawing, arcs as short lines, in units of the view box."""
    text = pathlib.Path(path).read_text()
    [data] = re.findall(r'\sd="([^"]*)"', text)
    tokens = re.findall(r"[MLHVAZ]|-?[\d.]+", data)
    points, command = [], None
    while tokens:
        if tokens[0].isalpha():
            command = tokens.pop(0)
            if command == "Z":
                continue
        take = {"M": 2, "L": 2, "H": 1, "V": 1, "A": 7}[command]
        numbers, tokens = [float(token) for token in tokens[:take]], tokens[take:]
        if command == "H":
            points.append((numbers[0], points[-1][1]))
        elif command == "V":
            points.append((points[-1][0], numbers[0]))
        elif command == "A":
            points += arc(points[-1], numbers)
        else:
            points.append(tuple(numbers))
    return np.array(points)


def arc(start, numbers):
    """Points of a circular arc after its start (SVG 1.1, appendix F.6, for equal radii)."""
    radius, _, _, large, sweep, *end = numbers
    (x1, y1), (x2, y2) = start, end
    chord = math.hypot(x2 - x1, y2 - y1)
    radius = max(radius, chord / 2)
    off = math.sqrt(max(radius**2 - (chord / 2) ** 2, 0.0))
    side = 1 if large != sweep else -1
    cx = (x1 + x2) / 2 - side * off * (y2 - y1) / chord
    cy = (y1 + y2) / 2 + side * off * (x2 - x1) / chord
    first, last = math.atan2(y1 - cy, x1 - cx), math.atan2(y2 - cy, x2 - cx)
    if sweep and last < first:
        last += math.tau
    if not sweep and last > first:
        last -= math.tau
    turns = np.linspace(first, last, 120)[1:]
    return [(cx + radius * math.cos(turn), cy + radius * math.sin(turn)) for turn in turns]


def drawn(path):
    """A marker's plate: how much of each pixel is inside of the figure, along the middle of its row."""
    texture = np.zeros((TEXTURE, TEXTURE))
    x, y = outline(path).T * (TEXTURE / 100) - 0.5
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    borders = np.arange(TEXTURE + 1) - 0.5
    for row in range(TEXTURE):
        crosses = (y <= row) != (next_y <= row)
        share = (row - y[crosses]) / (next_y - y)[crosses]
        at = np.sort(x[crosses] + share * (next_x - x)[crosses])
        for first, last in zip(at[::2], at[1::2]):
            texture[row] += np.diff(np.clip(borders, first, last))
    return texture


def modules(black):
    """A plate of square modules, 1 where one is black."""
    black = np.pad(black, 1)
    each = TEXTURE // len(black)
    return np.kron(black, np.ones((each, each), np.uint8))


def apriltag(identity):
    """A tag of the family 36h11 with its white border: ten modules."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return modules((cv2.aruco.generateImageMarker(dictionary, identity, 8) == 0).astype(np.uint8))


def aruco(identity):
    """A marker of the dictionary 4X4_50 with a white border: eight modules."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return modules((cv2.aruco.generateImageMarker(dictionary, identity, 6) == 0).astype(np.uint8))


def render(textures, conditions, rng):
    """A frame, and name: (x, y, turn) of what is on it. (0, 0) is the centre of the first pixel."""
    plate, blur, noise = conditions
    frame, truth = np.full((HEIGHT, WIDTH), FLOOR), {}
    cells = rng.permutation(COLUMNS * ROWS)[: len(textures)]
    for (name, texture), cell in zip(textures.items(), cells):
        room = 0.72 * plate + 8
        cell_x, cell_y = cell % COLUMNS * WIDTH / COLUMNS, cell // COLUMNS * HEIGHT / ROWS
        x = cell_x + rng.uniform(room, WIDTH / COLUMNS - room)
        y = cell_y + rng.uniform(room, HEIGHT / ROWS - room)
        turn = rng.uniform(-math.pi, math.pi)
        left, top, side = int(x - room) + 1, int(y - room) + 1, int(2 * room) - 1
        fine = (np.arange(side * FINE) + 0.5) / FINE - 0.5
        dx, dy = np.meshgrid(left + fine - x, top + fine - y)
        u = (math.cos(turn) * dx + math.sin(turn) * dy) / plate + 0.5
        v = (math.cos(turn) * dy - math.sin(turn) * dx) / plate + 0.5
        inside = (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
        at = lambda c: np.clip(c * TEXTURE, 0, TEXTURE - 1).astype(int)
        points = PAPER + (INK - PAPER) * texture[at(v), at(u)]
        points = np.where(inside, points, FLOOR)
        points = cv2.GaussianBlur(points, (0, 0), blur * FINE, borderType=cv2.BORDER_REPLICATE)
        pixels = points.reshape(side, FINE, side, FINE).mean(axis=(1, 3))
        frame[top : top + side, left : left + side] = pixels
        truth[name] = (x, y, turn)
    noisy = frame + rng.normal(0, noise, frame.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8), truth


def read_overcam(program, markers, frames, folder, noise, rng):
    """What overcam says of a folder of pictures, and of one of the empty floor."""
    floor = np.full((HEIGHT, WIDTH), FLOOR) + rng.normal(0, noise / 5, (HEIGHT, WIDTH))
    cv2.imwrite(str(folder / "floor.png"), np.clip(np.round(floor), 0, 255).astype(np.uint8))
    pictures = folder / "frames"
    pictures.mkdir()
    for i, (frame, _) in enumerate(frames):
        cv2.imwrite(str(pictures / f"{i:05}.png"), frame)
    command = [program, "--device", pictures, "--background", folder / "floor.png"]
    command += ["--markers", markers, "--json", "--no-publish"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode != 0:
        sys.exit(f"{program} failed: {run.stderr}")
    for line in run.stdout.splitlines():
        objects = json.loads(line)["objects"]
        read = [o for o in objects if o["kind"] == "marker" and o["observed"]]
        # A drawing points up, against y.
        yield [(o["marker"], o["x"], o["y"], o["heading"] + math.pi / 2) for o in read]


def read_apriltag(frames):
    """Quads are sharpened and edges refined; nothing is decimated."""
    detector = pupil_apriltags.Detector("tag36h11", quad_decimate=1.0, refine_edges=1)
    for frame, _ in frames:
        found = detector.detect(frame)
        yield [(f.tag_id, *f.center, direction(f.corners)) for f in found if f.hamming <= 2]


def read_aruco(frames):
    """Corners are refined along the contour, the best of the methods here; small markers are let through."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    settings.minMarkerPerimeterRate = 0.02
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    detector = cv2.aruco.ArucoDetector(dictionary, settings)
    for frame, _ in frames:
        corners, identities, _ = detector.detectMarkers(frame)
        found = zip(corners, [] if identities is None else identities.flatten())
        yield [(int(i), *crossing(c[0]), direction(c[0])) for c, i in found]


def crossing(corners):
    """Where the diagonals cross."""
    a, b, c, d = np.asarray(corners, float)
    (px, py), (qx, qy) = c - a, d - b
    along = ((b - a)[0] * qy - (b - a)[1] * qx) / (px * qy - py * qx)
    return a + along * (c - a)


def direction(corners):
    """Mean direction of two opposite sides."""
    a, b, c, d = np.asarray(corners, float)
    across = (b - a) + (c - d)
    return math.atan2(across[1], across[0])


def wrapped(angle):
    return (angle + math.pi) % math.tau - math.pi


def judge(frames, readings):
    """Recall, centre and heading errors, and readings that are no plate or another one."""
    errors, plates, wrong = [], 0, 0
    for (_, truth), found in zip(frames, readings):
        plates += len(truth)
        for name, x, y, turn in found:
            real = truth.get(name)
            if real is None or math.hypot(x - real[0], y - real[1]) > 5:
                wrong += 1
                continue
            errors.append((x - real[0], y - real[1], turn - real[2]))
    if not errors:
        return 0.0, math.nan, math.nan, wrong
    errors = np.array(errors)
    offset = np.round(2 * np.median(errors[:, :2], axis=0)) / 2
    place = errors[:, :2] - offset
    middle = math.atan2(np.sin(errors[:, 2]).mean(), np.cos(errors[:, 2]).mean())
    quarter = round(middle / (math.pi / 2)) * math.pi / 2
    turns = np.array([wrapped(turn - quarter) for turn in errors[:, 2]])
    flips = np.abs(turns) > math.radians(45)
    centre = math.sqrt((place**2).sum(axis=1).mean())
    heading = math.degrees(math.sqrt((turns[~flips] ** 2).mean()))
    return len(errors) / plates, centre, heading, wrong + int(flips.sum())


def main():
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("overcam")
    arguments.add_argument("markers", help="folder of SVG files")
    arguments.add_argument("--frames", type=int, default=20)
    arguments.add_argument("--plates", type=float, nargs="+", default=[10, 12, 14, 16, 20, 24, 32])
    arguments.add_argument("--blur", type=float, default=0.6)
    arguments.add_argument("--noise", type=float, default=3.0)
    given = arguments.parse_args()
    files = sorted(pathlib.Path(given.markers).glob("*.svg"))[:PER_FRAME]
    kinds = {
        "overcam": {file.stem: drawn(file) for file in files},
        "AprilTag 36h11": {i: apriltag(i) for i in range(PER_FRAME)},
        "ArUco 4x4": {i: aruco(i) for i in range(PER_FRAME)},
    }
    print(f"blur {given.blur} px, noise {given.noise}: recall, centre px, heading degrees, wrong\n")
    print("| plate | " + " | ".join(kinds) + " |\n| --- |" + " --- |" * len(kinds))
    for plate in given.plates:
        row = []
        for kind, textures in kinds.items():
            rng = np.random.default_rng(int(100 * plate))
            conditions = plate, given.blur, given.noise
            frames = [render(textures, conditions, rng) for _ in range(given.frames)]
            with tempfile.TemporaryDirectory() as folder:
                if kind == "overcam":
                    folder = pathlib.Path(folder)
                    read = read_overcam(given.overcam, given.markers, frames, folder, given.noise, rng)
                elif kind == "ArUco 4x4":
                    read = read_aruco(frames)
                else:
                    read = read_apriltag(frames)
                recall, centre, heading, wrong = judge(frames, read)
            row.append(f"{recall:.3f}, {centre:.4f}, {heading:.3f}, {wrong}")
        print(f"| {plate:g} px | " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
