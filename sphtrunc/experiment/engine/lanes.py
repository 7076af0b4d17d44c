"""Lanes: eight targets side by side in one SIMD vector, inside functions compiled by Numba.

The pair formula is ordinary Python. When Numba compiles `add_pair`, the formula runs once on
`Lanes`, numbers that emit instructions instead of computing: what comes out is straight-line vector
code for exactly the sums of a plan, all of it in registers. A lane never sees another one, so the
order of every sum is the order of the loop, whatever the width of the machine's vectors.

Products and sums may be fused (one rounding in place of two); nothing is ever reassociated.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import (
    NativeValue,
    intrinsic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

from sphtrunc.arithmetic.arrays import MOST
from sphtrunc.arithmetic.summation import UNIT
from sphtrunc.experiment.engine.pairs import Plan, pair_terms, row_counts

WIDTH = 8
_DOUBLE = ir.DoubleType()
_VECTOR = ir.VectorType(_DOUBLE, WIDTH)
_FUSE = ("contract",)
#: for every set of lanes, as bits: its lanes in order, then anything
_PACKED = [
    ([i for i in range(WIDTH) if bits >> i & 1] + [0] * WIDTH)[:WIDTH] for bits in range(1 << WIDTH)
]


class PlanType(types.Type):
    """Each plan is a type of its own: a loop is compiled, and cached, for a plan."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        super().__init__(name=f"Plan({sha256(repr(plan).encode()).hexdigest()[:32]})")


class LanesType(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"Lanes({WIDTH})")


lanes_type = LanesType()


@register_model(PlanType)
class _PlanModel(models.OpaqueModel):
    pass


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _VECTOR)


@typeof_impl.register(Plan)
def _typeof_plan(value: Plan, context: Any) -> PlanType:
    return PlanType(value)


@unbox(PlanType)
def _unbox_plan(typ: PlanType, obj: Any, c: Any) -> NativeValue:
    return NativeValue(c.context.get_dummy_value())


class Lanes:
    """A vector of doubles, or one double that all lanes share, while code is being emitted."""

    __slots__ = ("builder", "value", "wide")

    def __init__(self, builder: Any, value: Any, wide: bool) -> None:
        self.builder, self.value, self.wide = builder, value, wide

    def _pair(self, other: Any) -> tuple[Any, Any, bool]:
        if not isinstance(other, Lanes):
            other = Lanes(self.builder, ir.Constant(_DOUBLE, float(other)), False)
        if self.wide == other.wide:
            return self.value, other.value, self.wide
        return self.spread(), other.spread(), True

    def spread(self) -> Any:
        """The value in every lane."""
        if self.wide:
            return self.value
        if isinstance(self.value, ir.Constant):
            return ir.Constant(_VECTOR, [self.value] * WIDTH)
        first = self.builder.insert_element(
            ir.Constant(_VECTOR, ir.Undefined), self.value, ir.Constant(ir.IntType(32), 0)
        )
        order = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
        return self.builder.shuffle_vector(first, ir.Constant(_VECTOR, ir.Undefined), order)

    def _op(self, name: str, other: Any, swap: bool = False, flags: tuple[str, ...] = _FUSE) -> Any:
        a, b, wide = self._pair(other)
        if swap:
            a, b = b, a
        return Lanes(self.builder, getattr(self.builder, name)(a, b, flags=flags), wide)

    def __add__(self, other: Any) -> Lanes:
        return self._op("fadd", other)  # type: ignore[no-any-return]

    __radd__ = __add__

    def __sub__(self, other: Any) -> Lanes:
        return self._op("fsub", other)  # type: ignore[no-any-return]

    def __rsub__(self, other: Any) -> Lanes:
        return self._op("fsub", other, swap=True)  # type: ignore[no-any-return]

    def __mul__(self, other: Any) -> Lanes:
        return self._op("fmul", other)  # type: ignore[no-any-return]

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Lanes:
        return self._op("fdiv", other)  # type: ignore[no-any-return]

    def __neg__(self) -> Lanes:
        return Lanes(self.builder, self.builder.fneg(self.value), self.wide)

    def strictly(self, name: str, other: Any) -> Lanes:
        """The operation, never fused with another."""
        return self._op(name, other, flags=())  # type: ignore[no-any-return]


class LaneNumbers:
    """The functions of the pair formula for lanes."""

    def __init__(self, builder: Any) -> None:
        self.builder = builder

    def constant(self, c: float, error: float = 0.0) -> Lanes:
        return Lanes(self.builder, ir.Constant(_DOUBLE, float(c)), False)

    def _lanes(self, x: Any) -> Lanes:
        return x if isinstance(x, Lanes) else self.constant(x)

    def _call(self, name: str, *arguments: Any) -> Lanes:
        values = [self._lanes(a).spread() for a in arguments]
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(values))
        function = cgutils.get_or_insert_function(
            self.builder.module, kind, f"llvm.{name}.v{WIDTH}f64"
        )
        return Lanes(self.builder, self.builder.call(function, values), True)

    def difference(self, a: Lanes, b: Lanes) -> Lanes:
        return a - b

    def scale(self, x: Any) -> Lanes:
        """The power of two at or below |x|, 0 for denormal numbers."""
        words = ir.VectorType(ir.IntType(64), WIDTH)
        mask = ir.Constant(words, [0x7FF0000000000000] * WIDTH)
        bits = self.builder.bitcast(self._lanes(x).spread(), words)
        return Lanes(
            self.builder, self.builder.bitcast(self.builder.and_(bits, mask), _VECTOR), True
        )

    def sqrt(self, x: Any) -> Lanes:
        return self._call("sqrt", x)

    def size(self, x: Any) -> Lanes:
        return self._call("fabs", x)

    def _select(self, compare: str, a: Any, b: Any, yes: Any, no: Any) -> Lanes:
        chosen = self.builder.fcmp_ordered(
            compare, self._lanes(a).spread(), self._lanes(b).spread()
        )
        value = self.builder.select(chosen, self._lanes(yes).spread(), self._lanes(no).spread())
        return Lanes(self.builder, value, True)

    def larger(self, a: Any, b: Any) -> Lanes:
        return self._select(">", a, b, a, b)

    def smaller(self, a: Any, b: Any) -> Lanes:
        return self._select("<", a, b, a, b)

    def positive(self, x: Any) -> Lanes:
        return self.larger(x, 0.0)

    def others(self, squares: Any, x: Any) -> Lanes:
        return self._select(">", squares, 0.0, x, 0.0)

    def within(self, x: Any, edge: float, squares: Any) -> Lanes:
        one = self._select(">", squares, 0.0, 1.0 + MOST, 1.0)
        return self._select("<=", x, edge, one, -0.0)  # adds exactly nothing: one masked sum

    def pick(self, x: Any, knot: float, inner: Any, outer: Any, mean: float | None) -> Lanes:
        value = self._select("<", x, knot, inner, outer)
        return value if mean is None else self._select("==", x, knot, mean, value)


# ------------------------------------------------------------------ what a compiled loop may call


def _accumulators(plan: Plan) -> Any:
    return types.UniTuple(lanes_type, row_counts(plan)[2])


@intrinsic
def empty_sums(typing_context: Any, plan: Any) -> Any:
    """Zero in every sum of the plan."""
    kind = _accumulators(plan.plan)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        zero = ir.Constant(_VECTOR, [0.0] * WIDTH)
        return context.make_tuple(builder, kind, [zero] * len(kind))

    return kind(plan), codegen


@intrinsic
def load_targets(typing_context: Any, plan: Any, buffer: Any) -> Any:
    """The rows of a (rows, WIDTH) buffer as lanes."""
    kind = types.UniTuple(lanes_type, row_counts(plan.plan)[1])

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[1])(context, builder, arguments[1]).data
        values = [_load(builder, data, i * WIDTH) for i in range(len(kind))]
        return context.make_tuple(builder, kind, values)

    return kind(plan, buffer), codegen


@intrinsic
def store_sums(typing_context: Any, plan: Any, sums: Any, buffer: Any) -> Any:
    """Write the sums into a (rows, WIDTH) buffer."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[2])(context, builder, arguments[2]).data
        for i, value in enumerate(cgutils.unpack_tuple(builder, arguments[1])):
            place = builder.gep(data, [ir.Constant(ir.IntType(64), i * WIDTH)])
            builder.store(value, builder.bitcast(place, _VECTOR.as_pointer()), align=8)
        return context.get_dummy_value()

    return types.void(plan, sums, buffer), codegen


@intrinsic
def add_pair(typing_context: Any, plan: Any, sums: Any, targets: Any, sources: Any, j: Any) -> Any:
    """The sums with what particle j, column j of the (rows, n) sources, adds to eight targets."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[3])(context, builder, arguments[3])
        stride = builder.extract_value(array.strides, 0)
        column = builder.mul(arguments[4], ir.Constant(ir.IntType(64), 8))
        start = builder.ptrtoint(array.data, ir.IntType(64))
        start = builder.add(start, column)
        n_source = row_counts(plan.plan)[0]
        source = []
        for i in range(n_source):
            place = builder.add(start, builder.mul(stride, ir.Constant(ir.IntType(64), i)))
            pointer = builder.inttoptr(place, _DOUBLE.as_pointer())
            source.append(Lanes(builder, builder.load(pointer), False))
        target = [Lanes(builder, v, True) for v in cgutils.unpack_tuple(builder, arguments[2])]
        held = [Lanes(builder, v, True) for v in cgutils.unpack_tuple(builder, arguments[1])]
        result = _added(plan.plan, LaneNumbers(builder), held, target, source)
        return context.make_tuple(builder, signature.return_type, [x.spread() for x in result])

    return sums(plan, sums, targets, sources, j), codegen


@intrinsic
def list_near(
    typing_context: Any,
    plan: Any,
    sources: Any,
    j: Any,
    end: Any,
    low: Any,
    high: Any,
    square: Any,
    near: Any,
    number: Any,
) -> Any:
    """Append to `near` those of the particles j … j + 7, before `end`, whose squared distance from
    the box low … high is at most `square`; the new number of entries. Here the lanes are sources:
    they may be read, and eight entries written, beyond the last."""
    dim = plan.plan.dim

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = ir.IntType(64)

        def array(i: int) -> Any:
            return context.make_array(signature.args[i])(context, builder, arguments[i])

        n = LaneNumbers(builder)
        places, stride = array(1), builder.extract_value(array(1).strides, 0)
        distance: Any = None
        for axis in range(dim):
            row = builder.add(
                builder.ptrtoint(places.data, word),
                builder.mul(stride, ir.Constant(word, axis)),
            )
            pointer = builder.inttoptr(row, _DOUBLE.as_pointer())
            x = Lanes(builder, _load(builder, builder.gep(pointer, [arguments[2]]), 0), True)
            ends = [
                Lanes(
                    builder,
                    builder.load(builder.gep(array(i).data, [ir.Constant(word, axis)])),
                    False,
                )
                for i in (4, 5)
            ]
            outside = n.positive(n.larger(ends[0] - x, x - ends[1]))
            distance = outside * outside if distance is None else distance + outside * outside
        inside = builder.fcmp_ordered(
            "<=", distance.value, Lanes(builder, arguments[6], False).spread()
        )
        # which lanes, packed to the front by a table: no branch, one store
        left = builder.sub(arguments[3], arguments[2])
        left = builder.select(
            builder.icmp_signed("<", left, ir.Constant(word, WIDTH)), left, ir.Constant(word, WIDTH)
        )
        one = ir.Constant(word, 1)
        valid = builder.sub(builder.shl(one, left), one)
        bits = builder.zext(builder.bitcast(inside, ir.IntType(WIDTH)), word)
        bits = builder.and_(bits, valid)
        bytes_ = ir.VectorType(ir.IntType(8), WIDTH)
        table = cgutils.global_constant(
            builder,
            "lanes_packed",
            ir.Constant(
                ir.ArrayType(bytes_, 1 << WIDTH), [ir.Constant(bytes_, row) for row in _PACKED]
            ),
        )
        row = builder.load(builder.gep(table, [ir.Constant(word, 0), bits]))
        words = ir.VectorType(word, WIDTH)
        start = builder.insert_element(
            ir.Constant(words, ir.Undefined), arguments[2], ir.Constant(ir.IntType(32), 0)
        )
        order = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
        start = builder.shuffle_vector(start, ir.Constant(words, ir.Undefined), order)
        place = builder.gep(array(7).data, [arguments[8]])
        builder.store(
            builder.add(builder.zext(row, words), start),
            builder.bitcast(place, words.as_pointer()),
            align=8,
        )
        return builder.add(arguments[8], builder.ctpop(bits))

    return types.int64(plan, sources, j, end, low, high, square, near, number), codegen


def _added(plan: Plan, number: Any, held: list[Any], target: list[Any], source: list[Any]) -> Any:
    """Sums, then their compensations, then their bounds, with one pair more."""
    n = plan.sums
    terms = pair_terms(plan, number, target, source)
    values = [t.value if plan.bound else t for t in terms]
    sums, rest = [], []
    for i, x in enumerate(values):
        old = held[i]
        if not plan.compensated:
            sums.append(old + x)
            continue
        new = old.strictly("fadd", x)
        back = new.strictly("fsub", old)
        lost = old.strictly("fsub", new.strictly("fsub", back)).strictly(
            "fadd", number._lanes(x).strictly("fsub", back)
        )
        sums.append(new)
        rest.append(held[n + i].strictly("fadd", lost))
    if plan.bound:
        for i, term in enumerate(terms):
            more = term.error if plan.compensated else term.error + number.scale(sums[i]) * UNIT
            rest.append(held[len(held) - n + i] + more)
    return sums + rest


def _load(builder: Any, data: Any, offset: int) -> Any:
    place = builder.gep(data, [ir.Constant(ir.IntType(64), offset)])
    return builder.load(builder.bitcast(place, _VECTOR.as_pointer()), align=8)
