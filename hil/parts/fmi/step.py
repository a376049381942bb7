"""Step of an FMU as one compiled function: ``int step(instance, input, output)``, callable from the compiled loop.

It copies the mapped elements of the input record to staging arrays, sets the FMU's variables, steps it, gets its
outputs and copies them to the output record. What is copied and called is in tables that a component points to.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import carray, cfunc, types  # type: ignore[attr-defined]
from numba.extending import intrinsic

from hil.core.gnc_records import GncMode
from hil.core.jit import kernel
from hil.parts.fmi.binary import LOG_BYTES

CODES: Final = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
"""Types of staging arrays and records, by their number in the tables."""

FIELD_TEXT: Final = 64
COPY: Final = np.dtype(
    [
        ("offset", "i8"),  # in the record
        ("field_code", "i8"),
        ("address", "i8"),  # in a staging array
        ("code", "i8"),
        ("factor", "f8"),  # value in the receiver's unit: factor * value + shift
        ("shift", "f8"),
        ("text", "u1", FIELD_TEXT),  # message for a value that the receiver cannot hold
    ],
    align=True,
)
"""Copy of one element."""

CALL: Final = np.dtype(
    [
        ("function", "i8"),
        ("references", "i8"),  # address
        ("n", "i8"),
        ("values", "i8"),  # address
        ("n_values", "i8"),
        ("text", "u1", FIELD_TEXT),  # message for a failure
    ],
    align=True,
)
"""Call of a function that sets or gets variables of one type."""

GROUP: Final = np.dtype([("copies", "i8"), ("n_copies", "i8"), ("calls", "i8"), ("n_calls", "i8")], align=True)
"""Copies and calls that go together: addresses and lengths."""

NESTED_MAX: Final = 4
NESTED: Final = np.dtype(
    [
        ("groups", "i8"),  # address of GROUP for each record
        ("n", "i8"),  # records
        ("count_offset", "i8"),  # of the field in the input with the number of records that are valid
    ],
    align=True,
)
"""Array of records in the input."""

COMPONENT: Final = np.dtype(
    [
        ("component", "i8"),
        ("version", "i8"),
        ("do_step", "i8"),
        ("step_s", "f8"),
        ("input", GROUP),
        ("nested", NESTED, NESTED_MAX),
        ("output", GROUP),
        ("text_offset", "i8"),  # of the field text in the output
        ("direct", "i8"),  # offset of the field direct, set if the outputs open thrusters; 0: it is not set
        ("estimate", "i8"),  # offset of the field that is 1 with an estimate; 0: it is not set
        ("log", "i8"),  # address of the last message
        ("step_text", "u1", FIELD_TEXT),
        ("end_text", "u1", FIELD_TEXT),
    ],
    align=True,
)
"""Component of an FMU and its tables."""

_INPUT_HEAD = np.dtype([("cycle", "i8"), ("t_s", "f8"), ("mode", "i4"), ("orders", "i4")], align=True)
_RUNNING = GncMode.RUNNING.value
_INTEGER_MAX = float(2**53)
UNUSABLE: Final = 100
"""Returned for an output that its field cannot hold; failures of FMI functions return their status."""
ENDS: Final = 101
"""Returned if the FMU requests the end of the simulation."""

_machine_code: Any = intrinsic  # under this name: these functions are compiled at each start, outside the cache


@_machine_code
def _pointer(_typing, address):
    def generate(_context, builder, _signature, arguments):
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), generate


@_machine_code
def _address(_typing, pointer):
    def generate(_context, builder, _signature, arguments):
        return builder.ptrtoint(arguments[0], ir.IntType(64))

    return types.int64(types.voidptr), generate


@_machine_code
def _call_values(_typing, function, component, references, n, values, n_values):
    """Call a function that sets or gets variables; FMI 2.0's have no ``n_values``, and ignore it."""
    long = types.int64

    def generate(_context, builder, _signature, arguments):
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(32), [word] * 5)
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return types.int32(long, long, long, long, long, long), generate


@_machine_code
def _do_step_2(_typing, function, component, t_s, step_s):
    def generate(_context, builder, _signature, arguments):
        word, real, whole = ir.IntType(64), ir.DoubleType(), ir.IntType(32)
        kind = ir.FunctionType(whole, [word, real, real, whole])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), [*arguments[1:], whole(1)])

    return types.int32(types.int64, types.int64, types.float64, types.float64), generate


@_machine_code
def _do_step_3(_typing, function, component, t_s, step_s):
    """Return the status, and 256 more if the FMU requests the end of the simulation."""

    def generate(_context, builder, _signature, arguments):
        word, real, byte, whole = ir.IntType(64), ir.DoubleType(), ir.IntType(8), ir.IntType(32)
        flags = [builder.alloca(byte) for _ in range(3)]
        last = builder.alloca(real)
        for flag in flags:
            builder.store(byte(0), flag)
        kind = ir.FunctionType(whole, [word, real, real, byte, *(byte.as_pointer() for _ in flags), real.as_pointer()])
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        status = builder.call(function, [*arguments[1:], byte(1), *flags, last])
        ends = builder.zext(builder.icmp_unsigned("!=", builder.load(flags[1]), byte(0)), whole)
        return builder.or_(status, builder.shl(ends, whole(8)))

    return types.int32(types.int64, types.int64, types.float64, types.float64), generate


@kernel
def _read(address, code):
    """Return the number of type ``code`` at ``address`` as a float."""
    memory = _pointer(address)
    if code == 0:
        return float(carray(memory, (1,), np.float64)[0])
    if code == 6:
        return float(carray(memory, (1,), np.int32)[0])
    if code == 8:
        return float(carray(memory, (1,), np.int64)[0])
    if code == 1:
        return float(carray(memory, (1,), np.float32)[0])
    if code == 2:
        return float(carray(memory, (1,), np.int8)[0])
    if code == 3:
        return float(carray(memory, (1,), np.uint8)[0])
    if code == 4:
        return float(carray(memory, (1,), np.int16)[0])
    if code == 5:
        return float(carray(memory, (1,), np.uint16)[0])
    if code == 7:
        return float(carray(memory, (1,), np.uint32)[0])
    return float(carray(memory, (1,), np.uint64)[0])


@kernel
def _write(address, code, value):
    """Write ``value`` as type ``code`` at ``address``; return False if the type cannot hold it."""
    memory = _pointer(address)
    if code == 0:
        carray(memory, (1,), np.float64)[0] = value
        return True
    if code == 1:
        carray(memory, (1,), np.float32)[0] = value
        return True
    if not abs(value) <= _INTEGER_MAX or value != np.floor(value):
        return False
    whole = np.int64(value)
    if code == 6:
        carray(memory, (1,), np.int32)[0] = whole
        return whole == np.int64(np.int32(whole))
    if code == 2:
        carray(memory, (1,), np.int8)[0] = whole
        return whole == np.int64(np.int8(whole))
    if code == 3:
        carray(memory, (1,), np.uint8)[0] = whole
        return whole == np.int64(np.uint8(whole))
    if code == 4:
        carray(memory, (1,), np.int16)[0] = whole
        return whole == np.int64(np.int16(whole))
    if code == 5:
        carray(memory, (1,), np.uint16)[0] = whole
        return whole == np.int64(np.uint16(whole))
    if code == 7:
        carray(memory, (1,), np.uint32)[0] = whole
        return whole == np.int64(np.uint32(whole))
    carray(memory, (1,), np.int64)[0] = whole
    return code == 8 or whole >= 0


@kernel
def _write_text(component, output, text):
    """Write ``text`` (FIELD_TEXT,) as the text of the output record."""
    for i in range(FIELD_TEXT):
        carray(_pointer(output + component.text_offset), (FIELD_TEXT,), np.uint8)[i] = text[i]


@kernel
def _fail(component, output, text):
    """Write the FMU's last message, or ``text`` without one, as the text of the output record."""
    log = carray(_pointer(component.log), (LOG_BYTES,), np.uint8)
    if log[0] != 0:
        _write_text(component, output, log)
    else:
        _write_text(component, output, text)


@kernel
def _call_all(component, group, output):
    """Call what sets or gets the variables of ``group``; return the status, 0 if all went well."""
    calls = carray(_pointer(group.calls), (group.n_calls,), CALL)
    for i in range(group.n_calls):
        call = calls[i]
        status = _call_values(
            call.function, component.component, call.references, call.n, call.values, call.n_values
        )  # fmt: skip
        if status > 1:
            _fail(component, output, call.text)
            return status
    return 0


@kernel
def _set_group(component, group, record, output):
    """Copy and set the inputs of ``group``; return the status, 0 if all went well."""
    copies = carray(_pointer(group.copies), (group.n_copies,), COPY)
    for i in range(group.n_copies):
        copy = copies[i]
        value = _read(record + copy.offset, copy.field_code)
        if not _write(copy.address, copy.code, copy.factor * value + copy.shift):
            _write_text(component, output, copy.text)
            return UNUSABLE
    return _call_all(component, group, output)


@kernel
def _get_group(component, group, output):
    """Get and copy the outputs of ``group``; return the status, 0 if all went well."""
    status = _call_all(component, group, output)
    if status != 0:
        return status
    copies = carray(_pointer(group.copies), (group.n_copies,), COPY)
    for i in range(group.n_copies):
        copy = copies[i]
        value = copy.factor * _read(copy.address, copy.code) + copy.shift
        if not _write(output + copy.offset, copy.field_code, value):
            _write_text(component, output, copy.text)
            return UNUSABLE
    return 0


@kernel
def _stepped(instance, record_in, record_out):
    """Step a component (COMPONENT) with an input record; return the status, 0 if all went well."""
    component = carray(instance, (1,), COMPONENT)[0]
    head = carray(record_in, (1,), _INPUT_HEAD)[0]
    record, output = _address(record_in), _address(record_out)
    if head.mode != _RUNNING:
        return 0  # the run's time is held, and with it the FMU's
    status = _set_group(component, component.input, record, output)
    if status != 0:
        return status
    for j in range(NESTED_MAX):
        nested = component.nested[j]
        if nested.n > 0:
            groups = carray(_pointer(nested.groups), (nested.n,), GROUP)
            for i in range(min(carray(_pointer(record + nested.count_offset), (1,), np.int64)[0], nested.n)):
                status = _set_group(component, groups[i], record, output)
                if status != 0:
                    return status
    if component.version == 2:
        status = _do_step_2(component.do_step, component.component, head.t_s, component.step_s)
    else:
        status = _do_step_3(component.do_step, component.component, head.t_s, component.step_s)
        if status >= 256:
            _fail(component, output, component.end_text)
            return ENDS
    if status > 1:
        _fail(component, output, component.step_text)
        return status
    if component.direct != 0:
        _write(output + component.direct, 6, 1.0)
    if component.estimate != 0:
        _write(output + component.estimate, 8, 1.0)
    return _get_group(component, component.output, output)


def _step(instance, record_in, record_out):
    return _stepped(instance, record_in, record_out)


def _step_of_part(record_in, record_out, instance):
    return _stepped(instance, record_in, record_out)


_SIGNATURE = types.int32(types.voidptr, types.voidptr, types.voidptr)


@cache
def step_function() -> Any:
    """Return the step, a C function with the arguments of ``hil_gnc_step``; ``address`` is its attribute.

    Compiled once per process, in about a second.
    """
    return cfunc(_SIGNATURE)(_step)


@cache
def step_function_of_part() -> Any:
    """Return ``step_function`` with the arguments of the step of a backend: input, output, instance."""
    return cfunc(_SIGNATURE)(_step_of_part)
