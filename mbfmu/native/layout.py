"""How a model is written for the runtime: records that Python fills and C reads.

The C declarations are made of these types, so that both have one list. A file has the header first, then a section of
each kind of record, then the block of :mod:`.image`, then records of the libraries of the FMU. All numbers take eight
bytes, the low one first.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping

import numpy as np

from mbfmu.mechanics.loads.base import MAX_VALID_RATIO
from mbfmu.modeling.parameters import declared
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import Role, Type
from mbfmu.session import run_messages
from mbfmu.session.kernels.points import RUN_STATUS
from mbfmu.session.tolerances import COARSE_TOLERANCE
from mbfmu.session.wheel_monitor import PLACE_ROUNDING
from mbfmu.sheets.elements.bending import ADVICE, MAX_ACCURATE_ANGLE, MAX_VALID_ANGLE
from mbfmu.util.diagnostics import Diagnostic
from solvers.balance import PASSAGE_INACCURATE
from solvers.compiled.kernel import types
from solvers.loop_closure import Outcome, WorstRecord
from solvers.options import OPTIONS
from solvers.outcome import Code
from solvers.stepper import LIMITED_RTOL
from solvers.steppers.compiled_loop import LIMITED_TOLERANCE

from . import sundials
from .checksum import crc64
from .contents import Contents
from .entries import Entry
from .event_memory import (
    EVENT_FAILED,
    EVENT_REQUESTED_CODE,
    FAILURES,
    PARAMETER_CODE,
    RUN_ENDED_CODE,
    EventControlRecord,
)
from .exchange_memory import LEFT_BRANCH, NEXT_EVENT, NOT_DIFFERENTIABLE, RESTART, STATES_NOT_FINITE, TIMES
from .families import FAMILIES
from .kernel_table import USER_LIBRARY, USER_TABLE_SYMBOL, kernel_tables
from .start_checks import Flaw

ENTRY_C_TYPES = {
    types.float64: "double",
    types.int64: "int64_t",
    types.voidptr: "void *",
}  # what entry points are called with
FILE_MAGIC = int.from_bytes(b"mbfmu20a", "little")
TOKEN_BYTES = 40  # bytes of the identity of an FMU

RELOCATION = np.dtype([("at", "i8"), ("target", "i8")])  # see image.Relocation
VARIABLE = np.dtype(
    [
        ("name", "i8"),  # place in the text, in bytes
        ("allowed", "i8"),  # allowed values as text
        ("type", "i8"),  # place in interface.Type
        ("role", "i8"),  # place in interface.Role
        ("number", "i8"),  # among those of its role
        ("settable", "i8"),  # when: see SETTABLE
        ("fixed_in_exchange", "i8"),  # 1: a support whose acceleration is no input, constant in model exchange
        ("is_motion", "i8"),  # 1: an output that depends on positions and velocities alone
        ("start", "f8"),
        ("low", "f8"),
        ("high", "f8"),
        ("rest_scale", "f8"),  # magnitude of an input that must not change before a start in a steady state; else zero
    ]
)
ARRAY = np.dtype([("members", "i8"), ("count", "i8")])  # of FMI 3: first of its members, and how many
MEMBER = np.dtype([("variable", "i8")])
SETTABLE = ("never", "before", "between")  # never; until the initialization ends; between steps too
ENTRY = np.dtype(  # a number that follows parameters, see table.Entry
    [
        ("at", "i8"),  # place in the block
        ("input", "i8"),  # the variable that owns it; -1: none
        ("once", "i8"),  # 1: it is written at the start alone
        ("root", "i8"),
        ("sums", "i8"),  # first of its sums, and how many
        ("count", "i8"),
        ("base", "f8"),  # what it is while the parameters are those of the export
    ]
)
SUM = np.dtype([("terms", "i8"), ("count", "i8")])
TERM = np.dtype([("factors", "i8"), ("count", "i8"), ("coefficient", "f8")])
# power of a variable minus an offset; variable LENGTH is the characteristic length
FACTOR = np.dtype([("variable", "i8"), ("power", "f8"), ("offset", "f8")])
LENGTH_VARIABLE = -1
SENTENCE = np.dtype([("what", "i8"), ("remedy", "i8")])  # places in the text, by solvers.outcome.Code
FAILURE = np.dtype([("before", "i8"), ("between", "i8"), ("after", "i8")])  # by Outcome, then start_checks.Flaw
LIBRARY = np.dtype([("length", "i8"), ("sum", "i8")])  # bytes of a library that the runtime loads, and their CRC-64
NAME_RECORD = np.dtype([("name", "i8")])  # place in the text
SUPPORT_RECORD = np.dtype([("variable", "i8"), ("unit", "i8")])  # first input of a support; its unit in the text
# A rolling wheel: its name in the text, places of its multipliers in the block (-1: it has none), and of its
# coefficients of friction; number of its cut joint if it rolls on a profile (-1: on a plane), and places of the
# distance to the profile, of the two radii whose sum is that of the wheel, and of the ends of the profile
WHEEL_RECORD = np.dtype(
    [
        ("name", "i8"),
        ("normal_at", "i8"),
        ("longitudinal_at", "i8"),
        ("lateral_at", "i8"),
        ("longitudinal_friction_at", "i8"),
        ("lateral_friction_at", "i8"),
        ("profile_cut", "i8"),
        ("distance_at", "i8"),
        ("radius_at", "i8"),
        ("crown_at", "i8"),
        ("lower_at", "i8"),
        ("upper_at", "i8"),
    ]
)

SECTIONS = {
    "variables": VARIABLE,
    "arrays": ARRAY,
    "members": MEMBER,
    "entries": ENTRY,
    "sums": SUM,
    "terms": TERM,
    "factors": FACTOR,
    "relocations": RELOCATION,
    "kernels": RELOCATION,
    "sentences": SENTENCE,
    "failures": FAILURE,
    "rows": NAME_RECORD,
    "coordinates": NAME_RECORD,
    "cuts": NAME_RECORD,
    "loads": NAME_RECORD,
    "free_rates": NAME_RECORD,  # of the coordinates: their bodies if their rates are not given, else empty
    "supports": SUPPORT_RECORD,
    "events": NAME_RECORD,
    "event_parameters": MEMBER,  # variables of the parameters that events set
    "wheels": WHEEL_RECORD,
    "text": np.dtype("u1"),
}
HEADER_OFFSETS = (
    "clock",
    "out",
    "options",
    "counts",
    "length",
    "run_status",
    "worst",
    "massless",
    "ida",
    "exchange_x",
    "exchange_derivatives",
    "exchange_nominal",
    "exchange_times",
    "direction_states",
    "direction_inputs",
    "derivative_slopes",
    "derivative_outputs",
    "undetermined",
    "undetermined_time",
    "near_miss_factor",
    "near_miss_gap",
    "events",
    "event_values",
    "indicators",
)  # of arrays that C looks at, in the block
HEADER = np.dtype(
    [
        ("magic", "i8"),
        ("token", f"S{TOKEN_BYTES}"),
        ("table_sum", "i8"),  # CRC-64 of header and sections, with zero in its place
        ("block_sum", "i8"),  # CRC-64 of the block
        ("libraries_sum", "i8"),  # CRC-64 of the records of libraries after the block, and how many there are
        ("libraries_count", "i8"),
        ("family", "i8"),  # place in families.FAMILIES
        ("block", "i8"),  # where it begins in the file, and its bytes
        ("size", "i8"),
        ("saved", "i8"),  # of it, what is saved and restored
        ("saved_alone", "i8"),  # of that, what co-simulation needs
        ("root", "i8"),
        ("min_rtol", "f8"),  # a smaller tolerance is run as this one
        ("reports_coarse", "i8"),  # 1: a coarse tolerance is reported at the start
        ("user_kernels", "i8"),  # number of kernels in the library of user-defined ones
        ("reports_undetermined", "i8"),  # 1: some output is a force, and it is reported that forces are not determined
        ("steady", "i8"),  # 1: the start is a steady state
        ("exchange", "i8"),  # 1: model exchange is supported
        ("derivatives", "i8"),  # 1: directional derivatives are supported
        ("inputs", "i8"),  # number of inputs
        ("takes_rates", "i8"),  # 1: all inputs take a derivative by time in co-simulation
        ("positions", "i8"),  # number of free positions, and of velocities
        ("velocities", "i8"),
        ("has_events", "i8"),  # 1: there are events or sampled blocks
        ("indicators", "i8"),  # number of event indicators
        *((f"{name}_at", "i8") for name in HEADER_OFFSETS),
        *(field for name in SECTIONS for field in ((name, "i8"), (f"{name}_count", "i8"))),
    ]
)
STRUCTS = {
    "Header": HEADER, "Variable": VARIABLE, "Array": ARRAY, "Member": MEMBER, "Entry": ENTRY, "Sum": SUM, "Term": TERM,
    "Factor": FACTOR, "Relocation": RELOCATION, "Sentence": SENTENCE, "Failure": FAILURE, "Name": NAME_RECORD,
    "Support": SUPPORT_RECORD, "Wheel": WHEEL_RECORD, "Library": LIBRARY, "Options": OPTIONS, "RunStatus": RUN_STATUS,
    "Worst": WorstRecord.dtype, "EventControl": EventControlRecord.dtype,
}  # fmt: skip


TEXTS: dict[str, Diagnostic | str] = {  # of diagnostics, with fields that C fills
    "COARSE_TOLERANCE_TEXT": run_messages.COARSE_TOLERANCE_WARNING,
    "ENERGY_BALANCE_TEXT": run_messages.ENERGY_BALANCE,
    "EXCHANGED_ENERGY_PART": run_messages.EXCHANGED_ENERGY_PART,
    "INPUT_JUMP_TEXT": run_messages.INPUT_JUMP,
    "LIMITED_RTOL_TEXT": LIMITED_RTOL,
    "LIMITED_TOLERANCE_TEXT": LIMITED_TOLERANCE,
    "MASSLESS_EVENT_TEXT": run_messages.MASSLESS_EVENT,
    "NOT_LOCKED_TEXT": run_messages.NOT_LOCKED,
    "PRESCRIBED_BOUNCE_TEXT": run_messages.PRESCRIBED_BOUNCE,
    "PRESCRIBED_LOCK_TEXT": run_messages.PRESCRIBED_LOCK,
    "RESTING_BOUNCE_TEXT": run_messages.NATIVE_RESTING_BOUNCE,
    "RUN_ENDED_TEXT": run_messages.RUN_ENDED,
    "SINGULAR_EVENT_TEXT": run_messages.SINGULAR_EVENT,
    "START_BEYOND_STOP_TEXT": run_messages.START_BEYOND_STOP,
    "TOO_MANY_EVENTS_TEXT": run_messages.TOO_MANY_EVENTS,
    "SINGULAR_START_TEXT": run_messages.SINGULAR_START,
    "SLOW_PASSAGE_TEXT": run_messages.SLOW_PASSAGE,
    "LIFTING_WHEEL_TEXT": run_messages.LIFTING_WHEEL,
    "SLIPPING_WHEEL_TEXT": run_messages.SLIPPING_WHEEL,
    "SECOND_CONTACT_TEXT": run_messages.SECOND_CONTACT,
    "PROFILE_END_TEXT": run_messages.PROFILE_END,
    "UNDETERMINED_FORCES_TEXT": run_messages.UNDETERMINED_FORCES,
}


def signed(data: bytes, token: str, libraries: Iterable[bytes] = ()) -> bytes:
    """Return a file with the identity of the FMU that it is of, and with the checksums of its parts.

    ``libraries`` are those that the runtime may load; none are added if the file has some.
    """
    header = np.frombuffer(data, HEADER, 1).copy()
    block = int(header["block"][0])
    end = block + int(header["size"][0])
    found = [(len(library), crc64(library)) for library in libraries]
    records = np.array(found, np.int64).tobytes() if found else data[end:]
    header["token"], header["table_sum"], header["block_sum"] = token.encode(), 0, crc64(data[block:end])
    header["libraries_sum"] = crc64(records)
    if found:
        header["libraries_count"] = len(found)
    sections = data[HEADER.itemsize : block]
    header["table_sum"] = crc64(header.tobytes() + sections)
    return header.tobytes() + sections + data[block:end] + records


def declarations(contents: Contents, entries: Mapping[str, Entry]) -> str:
    """Return the C header of these records and of a library, given all entry points of its family by their names."""
    family, present = contents.family, contents.entries(entries)
    known = [(name, [ENTRY_C_TYPES[word] for word in entry.more]) for name, entry in entries.items()]
    lines = ["/* Made of mbfmu/native/layout.py. */", "#include <stdint.h>", ""]
    lines += [f"#define MAGIC INT64_C({FILE_MAGIC})", f"#define LENGTH ({LENGTH_VARIABLE})"]
    limits = {"MAX_ACCURATE_ANGLE": MAX_ACCURATE_ANGLE, "MAX_VALID_ANGLE": MAX_VALID_ANGLE}  # of shipped elements
    lines += [f"#define {name} {float(np.degrees(angle))!r} /* degrees */" for name, angle in limits.items()]
    lines += [f"#define MAX_VALID_RATIO {MAX_VALID_RATIO!r}", f"#define PASSAGE_INACCURATE {PASSAGE_INACCURATE}"]
    lines += [f"#define LEFT_BRANCH ({LEFT_BRANCH})", f"#define STATES_NOT_FINITE ({STATES_NOT_FINITE})"]
    lines += [f"#define NOT_DIFFERENTIABLE ({NOT_DIFFERENTIABLE})", f"#define EXCHANGE_TIMES {TIMES}"]
    lines += [f"#define RUN_ENDED ({RUN_ENDED_CODE})", f"#define EVENT_FAILED ({EVENT_FAILED})"]
    lines += [f"#define EVENT_REQUESTED ({EVENT_REQUESTED_CODE})", f"#define PARAMETER_REQUESTED ({PARAMETER_CODE})"]
    lines += [f"#define NEXT_EVENT {NEXT_EVENT}", f"#define RESTART {RESTART}"]
    lines.append(f"#define COARSE_TOLERANCE {COARSE_TOLERANCE!r}")
    lines.append(f"#define PLACE_ROUNDING {PLACE_ROUNDING!r}")
    lines += [f"#define {name} {json.dumps(str(template))}" for name, template in TEXTS.items()]
    lines.append(f"#define UNFOLD {json.dumps(ADVICE)}")
    words = {"USER_LIBRARY": USER_LIBRARY, "USER_TABLE": USER_TABLE_SYMBOL}
    lines += [*(f"#define {name} {json.dumps(word)}" for name, word in words.items()), ""]
    lines += [_struct(name, record) for name, record in STRUCTS.items()]
    lines += [
        _enum("TYPE", (t.name for t in Type)),
        _enum("ROLE", (r.name for r in Role)),
        _enum("SETTABLE", SETTABLE),
        _enum("SETTING", (p.name for p in declared(Settings))),
        _enum("CODE", (code.name for code in Code)),
        _enum("EVENT", FAILURES),
        _enum("ASSEMBLY", (outcome.name for outcome in (*Outcome, *Flaw))),
    ]
    for name, more in known:
        lines.append(f"typedef int32_t {_kind(name)}({', '.join(('int64_t *', 'void **', 'void *', *more))});")
    lines += sundials.declarations(ENTRY_C_TYPES, family)
    lines += ["typedef struct {", *(f"    {_kind(name)} *{name};" for name, _ in known)]
    lines += ["    const Callbacks *callbacks; /* of SUNDIALS; NULL: it is not used */", "} Family;"]
    lines += [f"{_kind(name)} mb_{family}_{name};" for name in present]
    called = "&callbacks" if family in sundials.SUNDIALS_FAMILIES else "0"
    row = ", ".join((*(f"mb_{family}_{name}" if name in present else "0" for name, _ in known), called))
    lines += [f"#define FAMILY {list(FAMILIES).index(family)}", f"static const Family family = {{{row}}};"]
    lines += ["typedef struct {", "    void *const *addresses; /* NULL: the library does not have them */"]
    lines += ["    int64_t count;", "} KernelTable;"]
    tables = kernel_tables()
    lines += [f"extern void *const {own.symbol}[];" for name, own in tables.items() if name in contents.parts]
    rows = (f"{{{own.symbol if name in contents.parts else 0}, {len(own.kernels)}}}" for name, own in tables.items())
    lines += [f"static const KernelTable kernel_tables[] = {{{', '.join(rows)}}};", ""]
    return "\n".join(lines)


def _kind(name: str) -> str:
    return f"{name.title().replace('_', '')}Entry"


def _enum(kind: str, words: Iterable[str]) -> str:
    return f"enum {{{', '.join(f'{kind}_{word.upper()}' for word in (*words, 'count'))}}};"


def _struct(name: str, record: np.dtype[np.void]) -> str:
    lines = ["typedef struct {"]
    for field in record.names or ():
        kind = record[field]
        if kind.kind == "S":
            lines.append(f"    char {field}[{kind.itemsize}];")
        else:
            lines.append(f"    {'int64_t' if kind.kind == 'i' else 'double'} {field};")
    return "\n".join([*lines, f"}} {name};"])
