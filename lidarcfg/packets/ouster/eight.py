"""Operations on eight pixels of a column at a time, as LLVM vectors, which fit any processor.

Plain loops would do the same, but there LLVM does not know that input and output do not overlap, so it does not
vectorise them.
"""

# mypy: disallow-untyped-calls=False
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

COUNT = 8
OCTETS, WORDS, NUMBERS = (ir.VectorType(one, COUNT) for one in (ir.IntType(8), ir.IntType(32), ir.DoubleType()))
FUSED = "contract", "nsz"  # as the loops: products may be fused with sums
STEPS = 1, 2, 3, 4  # words of a pixel


def _which(_: Any, words: Any, at: Any, step: Any, mask: Any) -> Any:
    """One bit for each of eight pixels of `step` words: whether its word `at`, under a mask, is not 0."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        found = builder.icmp_unsigned("!=", _masked(context, builder, signature, given), ir.Constant(WORDS, None))
        return builder.bitcast(found, ir.IntType(8))

    return types.uint8(words, at, step, mask), generate


def _place(
    _: Any, words: Any, at: Any, step: Any, mask: Any, unit_m: Any, ways: Any, i: Any, how: Any, out: Any, n: Any
) -> Any:
    """Write x, y, z of eight returns to `out`, from row n on. Ranges are the words of `_which`; beams begin at i.

    `ways` holds the components of the beams ahead, right and up. `how` holds cosine and sine of the encoder's angle,
    the offsets added to x, y and z, and the offset subtracted from the ranges.
    """

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        columns = zip(signature.args[5], cgutils.unpack_tuple(builder, given[5]), strict=True)
        ahead, right, up = (
            _load(builder, _pointer(context, builder, kind, one, given[6]), NUMBERS) for kind, one in columns
        )
        scalars = *cgutils.unpack_tuple(builder, given[7]), given[4]
        cos, sin, x_m, y_m, z_m, start_m, unit = (_everywhere(builder, one) for one in scalars)
        units = builder.sitofp(_masked(context, builder, signature, given), NUMBERS)
        length = _sum(builder, units, unit, start_m, builder.fsub)
        x = _sum(builder, ahead, cos, _product(builder, right, sin))
        y = _sum(builder, ahead, sin, _product(builder, right, cos), builder.fsub)
        rows = [_sum(builder, way, length, from_m) for way, from_m in ((x, x_m), (y, y_m), (up, z_m))]
        first = _pointer(context, builder, signature.args[8], given[8], builder.mul(given[9], given[9].type(3)))
        for part in range(3):
            _store(builder, _woven(builder, rows, part), builder.gep(first, [ir.IntType(64)(COUNT * part)]))
        return context.get_dummy_value()

    return types.void(words, at, step, mask, unit_m, ways, i, how, out, n), generate


def _copy(_: Any, words: Any, at: Any, step: Any, shift: Any, out: Any, n: Any) -> Any:
    """Write one octet of each of eight words, from bit `shift` on, to `out` from index n on."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        values = _words(builder, _pointer(context, builder, signature.args[0], given[0], given[1]), given[2])
        octets = builder.trunc(builder.lshr(values, _everywhere(builder, given[3])), OCTETS)
        _store(builder, octets, _pointer(context, builder, signature.args[4], given[4], given[5]))
        return context.get_dummy_value()

    return types.void(words, at, step, shift, out, n), generate


def _same(_: Any, octets: Any, i: Any, out: Any, n: Any) -> Any:
    """Copy eight octets from index i on to `out` from index n on."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        values = _load(builder, _pointer(context, builder, signature.args[0], given[0], given[1]), OCTETS)
        _store(builder, values, _pointer(context, builder, signature.args[2], given[2], given[3]))
        return context.get_dummy_value()

    return types.void(octets, i, out, n), generate


which: Any = intrinsic(_which)
same: Any = intrinsic(_same)
place: Any = intrinsic(_place)
copy: Any = intrinsic(_copy)


def _product(builder: Any, one: Any, other: Any) -> Any:
    return builder.fmul(one, other, flags=FUSED)


def _sum(builder: Any, one: Any, other: Any, more: Any, add: Any = None) -> Any:
    return (add or builder.fadd)(_product(builder, one, other), more, flags=FUSED)


def _masked(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    words, at, step, mask = given[:4]
    values = _words(builder, _pointer(context, builder, signature.args[0], words, at), step)
    return builder.and_(values, _everywhere(builder, mask))


def _words(builder: Any, pointer: Any, step: Any) -> Any:
    """Eight words, one every `step` words, shuffled out of the vectors that contain them."""
    found, end, other = [], builder.append_basic_block(), builder.append_basic_block()
    switch = builder.switch(step, other)
    for one in STEPS:
        with builder.goto_block(block := builder.append_basic_block()):
            values = _load(builder, pointer, WORDS)
            for part in range(1, one):
                more = _load(builder, builder.gep(pointer, [ir.IntType(64)(COUNT * part)]), WORDS)
                inside = [one * k - COUNT * part for k in range(COUNT)]
                first = range(COUNT) if part > 1 else [min(one * k, COUNT - 1) for k in range(COUNT)]
                lanes = [COUNT + lane if 0 <= lane < COUNT else old for lane, old in zip(inside, first, strict=True)]
                values = builder.shuffle_vector(values, more, _lanes(lanes))
            builder.branch(end)
        switch.add_case(step.type(one), block)
        found.append((values, block))
    with builder.goto_block(other):
        builder.unreachable()
    builder.position_at_end(end)
    either = builder.phi(WORDS)
    for values, block in found:
        either.add_incoming(values, block)
    return either


def _woven(builder: Any, rows: list[Any], part: int) -> Any:
    """One third of the sequence x, y, z, x, y, z … of eight points, from the rows of x, y and z."""
    places = [divmod(COUNT * part + k, 3) for k in range(COUNT)]
    two = builder.shuffle_vector(rows[0], rows[1], _lanes([point + COUNT * (row == 1) for point, row in places]))
    return builder.shuffle_vector(
        two, rows[2], _lanes([COUNT + point if row == 2 else k for k, (point, row) in enumerate(places)])
    )


def _lanes(lanes: list[int]) -> Any:
    return ir.Constant(WORDS, lanes)


def _everywhere(builder: Any, value: Any) -> Any:
    """A vector with the value in every lane."""
    kind = ir.VectorType(value.type, COUNT)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.IntType(32)(0))
    return builder.shuffle_vector(one, one, _lanes([0] * COUNT))


def _pointer(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    return builder.gep(context.make_array(kind)(context, builder, array).data, [index])


def _load(builder: Any, pointer: Any, kind: Any) -> Any:
    return builder.load(builder.bitcast(pointer, kind.as_pointer()), align=1)


def _store(builder: Any, value: Any, pointer: Any) -> None:
    builder.store(value, builder.bitcast(pointer, value.type.as_pointer()), align=1)
