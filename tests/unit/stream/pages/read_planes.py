#!/usr/bin/env python3
"""A decoder of PageCodec::Planes by docs/page-codec.md alone, and what it says of the golden blobs beside it.

It shares nothing with libs/stream, so that the document, the blobs and the library cannot be wrong together.
"""

import math
import pathlib
import sys

STATES, ONE, LOW, SYMBOLS, ESCAPE, SPREADS = 16, 1 << 10, 1 << 15, 64, 63, 24
FRACTION = 1 << 32

# docs/page-codec.md, "Tables"
LAPLACE = [
    3647826, 11236458, 28939262, 64117488, 125169061, 219682085, 352552385, 524769008, 733210082, 971353370,
    1230528733, 1501288023, 1774574125, 2042530528, 2298930330, 2539287885, 2760749505, 2961857832, 3142265200,
    3302447338, 3443447232, 3566662659, 3673680208, 3766152322,
]
GAUSS = [
    0, 0, 0, 90, 16006, 622734, 8291237, 51716756, 188707693, 471297971, 900274053, 1422747122, 1966379316,
    2471973373, 2906120241, 3258380701, 3532943729, 3740940864, 3895366193, 4008393527, 4090289770, 4149207046,
    4191379343, 4221458109,
]


def times(a, b):
    return a * b >> 32


def frequencies(shape, spread):
    if shape == 0:
        half = LAPLACE[spread]
        whole = times(half, half)
        weights = [FRACTION - half, times(half, FRACTION - whole) // 2]
        while len(weights) < SYMBOLS // 2:
            weights.append(times(weights[-1], whole))
        total = FRACTION
    else:
        ratio = GAUSS[spread]
        twice = times(ratio, ratio)
        weights = [FRACTION]
        while len(weights) < SYMBOLS // 2:
            weights.append(times(weights[-1], ratio))
            ratio = times(ratio, twice)
        total = weights[0] + 2 * sum(weights[1:])
    out = [0] * SYMBOLS
    out[ESCAPE] = 1
    for symbol in range(1, ESCAPE):
        eighths = weights[(symbol + 1) // 2] * 8 * ONE // total
        out[symbol] = 0 if eighths < 2 else 1 if eighths < 12 else (eighths + 4) // 8
    out[0] = ONE - sum(out)
    return out


class Table:
    """symbol, place within it and frequency of each of a state's low bits"""

    def __init__(self, shape, spread):
        self.entries = []
        for symbol, frequency in enumerate(frequencies(shape, spread)):
            self.entries += [(symbol, place, frequency) for place in range(frequency)]
        assert len(self.entries) == ONE


TABLES = {}


def table(shape, spread):
    if (shape, spread) not in TABLES:
        TABLES[shape, spread] = Table(shape, spread)
    return TABLES[shape, spread].entries


def unzigzag(value):
    return value >> 1 if value & 1 == 0 else -(value + 1 >> 1)


class Blob:
    def __init__(self, data, count):
        self.count = count
        assert data[0] == 3, "format"
        self.flags, at = data[1], 2
        sizes = []
        for _ in range(2):
            value, at = self.varint_at(data, at)
            sizes.append(value)
        self.descriptions, at = data[at : at + sizes[0]], at + sizes[0]
        self.at = 0
        words, at = data[at : at + 2 * sizes[1]], at + 2 * sizes[1]
        self.words = [words[k] | words[k + 1] << 8 for k in range(0, len(words), 2)]
        self.states = [self.words[2 * k] | self.words[2 * k + 1] << 16 for k in range(STATES)]
        self.next_word = 2 * STATES
        self.plain_bytes = len(data) - at
        self.plain = int.from_bytes(data[at:], "little")
        self.plain_at = 0

    @staticmethod
    def varint_at(data, at):
        value = shift = 0
        while True:
            value |= (data[at] & 127) << shift
            shift += 7
            at += 1
            if data[at - 1] < 128:
                return value, at

    def byte(self):
        self.at += 1
        return self.descriptions[self.at - 1]

    def varint(self):
        value, self.at = self.varint_at(self.descriptions, self.at)
        return value

    def number(self):
        return unzigzag(self.varint())

    def bits(self, count):
        value = self.plain >> self.plain_at & (1 << count) - 1
        self.plain_at += count
        return value

    def symbol(self, lane, entries):
        x = self.states[lane % STATES]
        symbol, place, frequency = entries[x % ONE]
        x = frequency * (x // ONE) + place
        if x < LOW:
            x = x << 16 | self.words[self.next_word]
            self.next_word += 1
        self.states[lane % STATES] = x
        return symbol

    def plane(self, shifts, contexts, before):
        """`before`: the channels of the same attribute that come before this one."""
        kind, width = self.byte(), self.byte()
        predictor, shape, slope = kind & 7, kind >> 3 & 1, (kind >> 4 & 3) + 1
        offset = self.number()
        per_class = self.number() if kind >> 6 & 1 else 0
        if predictor == 0:
            return [offset] * self.count
        symbols, low_bits = [], []
        for lane in range(self.count):
            spread = max(0, width - slope * shifts[lane])
            low = (spread - SPREADS) // 4 + 1 if spread >= SPREADS else 0
            low_bits.append(low)
            symbols.append(self.symbol(lane, table(shape, spread - 4 * low)))
        for lane, symbol in enumerate(symbols):
            if symbol == ESCAPE:
                bits = self.bits(6)
                symbols[lane] = 1 << bits - 1 | self.bits(bits - 1) if bits > 0 else 0
        colour = len(before) % 3
        out = []
        for lane, symbol in enumerate(symbols):
            low = low_bits[lane]
            residual = unzigzag(symbol)
            if low > 0:
                residual = (residual << low) + self.bits(low) - (1 << low - 1)
            predicted = offset + int(per_class * (contexts[lane] - 16) / 8)  # towards 0
            if predictor == 2:
                predicted += out[lane - 1] if lane > 0 else 0
            elif predictor == 3:
                predicted += before[-1][lane] + before[-colour][lane] >> 1
            elif predictor == 4:
                predicted += out[lane - 1] + before[-1][lane] - before[-1][lane - 1] if lane > 0 else before[-1][0]
            half = (1 << shifts[lane]) // 2
            out.append(residual + (predicted + half >> shifts[lane]) << shifts[lane])
        return out

    def gaps(self):
        nothing = [0] * self.count
        out = []
        for number in self.plane(nothing, nothing, []):
            exponent = number // 2
            top = 1 if exponent == 0 else (2 | number & 1) << exponent - 1
            out.append(top + self.bits(max(0, exponent - 1)) - 1)
        return out

    def finish(self):
        assert self.at == len(self.descriptions), "descriptions go on"
        assert self.next_word == len(self.words), "words go on"
        assert (self.plain_at + 7) // 8 == self.plain_bytes and self.plain >> self.plain_at == 0, "plain bits go on"
        assert self.states == [LOW] * STATES, "states do not end where they began"


def log2_down(x):
    return math.frexp(x)[1] - 1


class Layout:
    """[(attribute, channels, step)]"""

    SHIFTS = {  # log2 of the finest unit, and the cap
        "LogScale": (1 / 128, 6),
        "ShRest": (1 / 128, 7),
        "ShDc": (1 / 64, 7),
        "Opacity": (1 / 3200, 4),
        "Albedo": (1 / 200, 6),
        "Residual": (1 / 512, 7),
        "Normal": (1 / 256, 6),
        "Rotation": (1 / 128, 7),
    }

    def __init__(self, attributes):
        self.attributes = attributes
        steps = {name: step for name, _, step in attributes}
        self.steps = steps
        self.octaves = math.floor(min(1.0, steps["LogScale"] / math.log(2)) * (1 << 15) + 0.5)

    def shift(self, attribute, klass, scales):
        if klass == 0 or attribute == "Visibility":
            return 0
        smallest, middle, largest = sorted(scales)
        if attribute == "Mean":
            more, cap = -log2_down(self.steps["Mean"]) - 6 + (middle * self.octaves >> 15), 10
        else:
            unit, cap = self.SHIFTS[attribute]
            more = log2_down(unit / self.steps[attribute])
            if attribute == "Rotation":
                eighths = (largest - middle) * self.octaves >> 12
                more += 2 if eighths < 1 else 1 if eighths < 3 else 0 if eighths < 6 else -(eighths + 4 >> 3)
        return min(cap, max(0, klass - 16 + more))


def read_page(data, layout, count):
    """Planes by attribute, object ids, Gaussian ids and shifts by attribute, in the order of the blob's lanes."""
    blob = Blob(data, count)
    nothing = [0] * count
    classes = blob.plane(nothing, nothing, [])
    planes, shifts = {}, {}
    order = ["LogScale"] + [name for name, _, _ in layout.attributes if name != "LogScale"]
    channels = {name: number for name, number, _ in layout.attributes}
    for name in order:
        scales = list(zip(*planes["LogScale"])) if name != "LogScale" else [(0, 0, 0)] * count
        shifts[name] = [layout.shift(name, k, s) for k, s in zip(classes, scales)]
        planes[name] = []
        if name == "Mean":
            planes[name] = read_means(blob, shifts[name])
            continue
        contexts = shifts[name] if name == "Rotation" else classes
        for channel in range(channels[name]):
            before = planes[name] if channel % 3 != 0 else []
            planes[name].append(blob.plane(shifts[name], contexts, before))
    objects = []
    while len(objects) < count:
        length = count if blob.flags & 2 else blob.varint() + 1
        objects += [blob.varint()] * length
    assert len(objects) == count
    ids, identity = [0] * count, 0
    if blob.flags & 1:
        for lane, gap in enumerate(blob.gaps()):
            identity = (identity + unzigzag(gap)) % (1 << 64)
            ids[lane] = identity
    if blob.flags & 4:
        left = list(range(count))
        to = [left.pop(place) for place in blob.gaps()]

        def scattered(values):
            out = [None] * count
            for value, lane in zip(values, to):
                out[lane] = value
            return out

        planes = {name: [scattered(plane) for plane in of] for name, of in planes.items()}
        shifts = {name: scattered(of) for name, of in shifts.items()}
        objects, ids = scattered(objects), scattered(ids)
    blob.finish()
    return planes, objects, ids, shifts


def read_means(blob, shifts):
    origin = [blob.number() for _ in range(3)]
    bits = [blob.byte() for _ in range(3)]
    low_bits = blob.byte()
    key, cells = 0, []
    for gap in blob.gaps():
        key += gap
        cell, rest = [0, 0, 0], key
        for bit in range(max(bits)):
            for axis in range(3):
                if bit < bits[axis]:
                    cell[axis] |= (rest & 1) << bit
                    rest >>= 1
        cells.append(cell)
    out = [[], [], []]
    for cell, shift in zip(cells, shifts):
        for axis in range(3):
            low = blob.bits(low_bits - shift) << shift if low_bits > shift else 0
            out[axis].append(origin[axis] + (cell[axis] << low_bits) + low)
    return out


LIMITS = {"Opacity": (0, 255), "Visibility": (0, 255), "Normal": (-512, 512)}
COUNT = 333


def golden_page(attributes):
    """golden_page() of page_codec_test.cpp."""
    state = 12345

    def below(n):
        nonlocal state
        state = (state * 1664525 + 1013904223) % (1 << 32)
        return (state >> 8) % n

    planes = {name: [[] for _ in range(channels)] for name, channels, _ in attributes}
    for _ in range(COUNT):
        for name, channels, _ in attributes:
            for channel in range(channels):
                value = below(200) - 100 if below(7) == 0 else below(20) - 10
                if name == "Mean":
                    value = below(3000) - 1500
                elif name == "LogScale":
                    value -= 200 + below(100)
                elif name == "Opacity":
                    value = 255 - below(120)
                elif name == "Visibility":
                    value = abs(value)
                planes[name][channel].append(value)
    return planes


def check(folder, name, attributes, rounded, kept_order):
    data = (folder / name).read_bytes()
    planes, objects, ids, shifts = read_page(data, Layout(attributes), COUNT)
    columns = [(identity - 1_000_000) // 3 for identity in ids]
    assert sorted(columns) == list(range(COUNT)), f"{name}: ids"
    if kept_order:
        assert columns == [(7 * lane) % COUNT for lane in range(COUNT)], f"{name}: order"
    assert objects == [0 if column < 100 else 17 for column in columns], f"{name}: objects"
    truth = golden_page(attributes)
    coarse = 0
    for attribute, channels, _ in attributes:
        for channel in range(channels):
            for lane, column in enumerate(columns):
                value, exact = planes[attribute][channel][lane], truth[attribute][channel][column]
                shift = shifts[attribute][lane] if rounded else 0
                coarse += shift
                nearest = exact + (1 << shift) // 2 >> shift << shift
                highest = LIMITS.get(attribute, (0, 1 << 26))[1] >> shift << shift
                if value != min(nearest, highest):
                    sys.exit(f"{name}: {attribute} {channel} of {column} is {value}, should be {nearest} of {exact}")
    assert not rounded or coarse > COUNT, f"{name}: nothing is rounded"
    print(f"{name}: {len(data)} bytes, as it should be")


def main():
    folder = pathlib.Path(sys.argv[1])
    radiance = [("Mean", 3, 1 / 4096), ("LogScale", 3, 1 / 64), ("Rotation", 3, 1 / 128), ("Opacity", 1, 1 / 255),
                ("ShDc", 3, 1 / 72), ("ShRest", 9, 1 / 64)]
    transfer = [("Mean", 3, 1 / 4096), ("LogScale", 3, 1 / 64), ("Rotation", 3, 1 / 128), ("Opacity", 1, 1 / 255),
                ("Albedo", 3, 1 / 255), ("Residual", 27, 1 / 128), ("Normal", 2, 1 / 512), ("Visibility", 1, 1 / 255)]
    check(folder, "planes.bin", radiance, False, False)
    check(folder, "planes_rounded.bin", radiance, True, False)
    check(folder, "planes_transfer.bin", transfer, True, True)


main()
