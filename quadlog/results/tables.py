"""Parquet tables of a run folder: their columns, written as a stream, read back as numpy columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from itertools import chain
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from quadlog.errors import NotARun, TooLarge, UnknownName
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.record import reading
from quadlog.storage.atomic_write import whole_file

_NUMPY = {pa.int64(): np.int64, pa.float64(): np.float64, pa.bool_(): np.bool_, pa.string(): np.object_}
_TYPES = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_(), "text": pa.string()}


def table_schema(columns: str) -> pa.Schema:
    """A schema from names separated by spaces: float64 that may be null, or the type after a colon: int, bool, text."""
    pairs = [column.partition(":")[::2] for column in columns.split()]
    return pa.schema([pa.field(name, _TYPES[kind or "float"], nullable=not kind) for name, kind in pairs])


METRIC_NAMES = tuple(CATALOGUE)
_JOINTS = (("q", "rad"), ("dq", "radps"), ("tau", "nm"))

COST_NAMES = ("wall_s", "peak_memory_mb", "input_bytes")
"""Cost of replaying a recording in a batch."""

JOINT_COLUMNS = tuple(tuple(f"{of}_{joint:02d}_{unit}" for joint in range(12)) for of, unit in _JOINTS)
"""Names of a body's angles, rates and torques, by joint."""
CONTACTS = tuple(f"contact_{leg}" for leg in range(4))
FOOT_FORCES = tuple(f"foot_force_{leg}_n" for leg in range(4))
DUTY_FACTORS = tuple(f"duty_factor_{leg}" for leg in range(4))
FORCES, _TORQUES = tuple(f"fz_{leg}_n" for leg in range(4)), JOINT_COLUMNS[2]
WANTED_FORCES = tuple(f"wanted_{name}" for name in FORCES)
BODY_COLUMNS = ("fallen", *FORCES, *WANTED_FORCES, "us_median", "us_max")
"""Of control, what only a robot with a body has, and metrics are made of."""
_PLANS = table_schema(
    "t_ns:int planner:text found:bool expanded:int generated:int cost length_m optimal_cost from_scratch:bool "
    "reused_cells:int start_x_m start_y_m goal_x_m goal_y_m goal_projected:bool us"
)
_POSES = table_schema("t_ns:int x_m y_m yaw_rad source:text z_m roll_rad pitch_rad")
_PATHS = table_schema("t_ns:int i:int x_m y_m smooth_x_m smooth_y_m")

TABLES: dict[str, pa.Schema] = {
    "fixes": table_schema(
        "t_ns:int tag:int x_m y_m z_m cov_xx_m2 cov_xy_m2 cov_yy_m2 n_ranges:int residual_rms_m outlier:bool"
    ),
    "ranges": table_schema("t_ns:int tag:int anchor:int range_m predicted_m weight"),
    "links": table_schema(
        "tag:int anchor:int x_m y_m z_m n:int residual_rms_m residual_median_m bias_m bias_std_m bias_applied:bool "
        "why_not:text range_std_m nlos_share weak_first_path_share"
    ),
    "uwb_errors": table_schema("t_ns:int tag:int source:text error_x_m error_y_m bound_m"),
    "innovations": table_schema("t_ns:int tag:int n_ranges:int nis"),
    "poses": _POSES,
    "other_poses": _POSES,
    "pose_uncertainty": table_schema("t_ns:int cov_xx_m2 cov_xy_m2 cov_yy_m2 yaw_std_rad"),
    "target": table_schema("t_ns:int x_m y_m source:text"),
    "joints": table_schema(f"t_ns:int {' '.join((*chain(*JOINT_COLUMNS), *CONTACTS, *FOOT_FORCES))}"),
    "scans": table_schema(
        "t_ns:int n_raw:int n_valid:int n_outlier:int n_ground:int n_obstacle:int "
        "ground_nx ground_ny ground_nz ground_d_m ground_found:bool ms"
    ),
    "plans": _PLANS,
    "paths": _PATHS,
    "astar": table_schema("t_ns:int expanded:int"),
    "resim_plans": _PLANS,
    "resim_paths": _PATHS,
    "control": table_schema(
        "t_ns:int x_m y_m z_m roll_rad pitch_rad yaw_rad vx_mps vy_mps yaw_rate_radps ref_x_m ref_y_m error_m "
        "cross_track_m time_error_m heading_error_rad plan_error_m lookahead_m k_v k_w cmd_v_mps cmd_yaw_rate_radps "
        f"{' '.join((*_TORQUES, *FORCES))} fallen:bool energy_j {' '.join(WANTED_FORCES)} us_median us_max cmd_vy_mps"
    ),
    "clearances": table_schema("t_ns:int clearance_m target_distance_m"),
    "contacts": table_schema("t_ns:int duration_s x_m y_m clearance_m cause:text collision:bool"),
    "body": table_schema("body:text joint:text phase:text torque_rms_nm torque_peak_nm n:int n_unknown:int"),
    "gait": table_schema(
        f"body:text n:int speed_mps stride_frequency_hz {' '.join(DUTY_FACTORS)} cost_of_transport "
        "pitch_mean_rad pitch_std_rad"
    ),
    "summary": table_schema(
        f"recording:text exit_code:int reason:text {' '.join((*METRIC_NAMES, *COST_NAMES))} worker:text"
    ),
}

# Columns that may be left out when writing, and are then null.
OPTIONAL = {"optimal_cost", "k_v", "k_w", "plan_error_m", "energy_j", "us_median", "us_max", "cmd_vy_mps", "worker"}
OPTIONAL |= {*_TORQUES, *FORCES, *WANTED_FORCES, *CONTACTS, *METRIC_NAMES, *COST_NAMES}

UNBOUNDED = frozenset({"clearance_m", "bias_std_m", "bound_m", "yaw_std_rad", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2"})
"""Columns in which infinity is valid: nothing near, or nothing known. Elsewhere it is damage."""

# Columns that older tables lack, as those above; they are read as NaN or empty text.
ADDED = OPTIONAL | {"z_m", "roll_rad", "pitch_rad"}

# Size of row groups, whatever the size of batches, so that files depend only on the data and memory is bounded.
_GROUP_ROWS = 16384
# 2 GB in memory: thirty hours of control at 50 Hz.
_MAX_VALUES = 250_000_000
LARGEST = 1e150
"""The largest finite number of a table; squares of larger ones overflow."""


class TableWriter(ExitStack[bool | None]):
    """A table that grows batch by batch and appears, whole, when its `with` block ends without an error.

    Columns are checked by name and type against the schema; ValueError or
    TypeError names the one that is wrong. CannotWrite when the disk is full.
    """

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        super().__init__()
        self.path, self.schema = path, schema
        self._rows: list[Mapping[str, Any]] = []
        self._pending = pa.Table.from_batches([], schema)

    def __enter__(self) -> Self:
        texts = [field.name for field in self.schema if field.type == pa.string()]
        form: dict[str, Any] = {"compression": "zstd", "use_dictionary": texts, "write_page_checksum": True}
        part = self.enter_context(whole_file(self.path))
        self._parquet = self.enter_context(pq.ParquetWriter(part, self.schema, **form))
        self.push(self._finish)
        return self

    def _finish(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._take(None, smallest=1)

    def append(self, columns: Mapping[str, Any]) -> None:
        """Add rows from columns of equal length; a scalar fills the whole column."""
        self._take(columns)

    def add_row(self, row: Mapping[str, Any]) -> None:
        """One row; a column that the row leaves out must be optional, and None is no value."""
        missing = [name for name in self.schema.names if name not in row and name not in OPTIONAL]
        if missing:
            raise ValueError(f"columns missing: {missing}")
        self._rows.append(row)
        if len(self._rows) >= 1024:
            self._take(None)

    def _take(self, columns: Mapping[str, Any] | None, smallest: int = _GROUP_ROWS) -> None:
        """Add the rows, then the columns, and write what fills groups."""
        rows, self._rows = self._rows, []
        parts: list[Mapping[str, Any]] = [columns] if columns is not None else []
        if rows:
            parts.insert(0, {name: [row.get(name) for row in rows] for name in sorted(set().union(*rows))})
        table = pa.concat_tables([self._pending, *(_table(self.schema, part) for part in parts)])
        if table.num_rows >= smallest:
            table = table.combine_chunks()
        while table.num_rows >= smallest:
            self._parquet.write_table(table.slice(0, _GROUP_ROWS), row_group_size=_GROUP_ROWS)
            table = table.slice(_GROUP_ROWS)
        self._pending = table


def write_table(path: Path, schema: pa.Schema, columns: Mapping[str, Any]) -> None:
    """A whole table at once. Raises as TableWriter does."""
    with TableWriter(path, schema) as table:
        table.append(columns)


def has_table(run: Path, name: str) -> bool:
    """Whether the run folder `run` has the table `name`; it may still be damaged."""
    return (run / f"{name}.parquet").is_file()


def read_table(
    run: Path, name: str, columns: Sequence[str] | None = None, *, largest: float = LARGEST
) -> dict[str, NDArray[Any]]:
    """The table `name` (`fixes`, `poses`, ...) of a run folder as numpy columns (N,), all or some.

    int64, float64 (NaN where there is no value), bool, or str objects.
    largest: a larger number counts as damage, and so does infinity where the column is not one of UNBOUNDED.

    Raises NotARun for a missing, damaged or foreign file, TooLarge for one that
    would not fit in memory, UnknownName for a table or column the contract does not have.
    """
    if name not in TABLES:
        raise UnknownName("table", name, TABLES)
    schema, path = TABLES[name], run / f"{name}.parquet"
    wanted = list(schema.names if columns is None else columns)
    for column in wanted:
        if column not in schema.names:
            raise UnknownName(f"column of {name}", column, schema.names)
    table, found = read_parquet(path, wanted), {}
    for column in wanted:
        kind = schema.field(column).type
        if column in table.column_names:
            found[column] = _to_numpy(path, column, table.column(column), kind)
        elif column in ADDED:
            found[column] = np.full(table.num_rows, *(("", object) if kind == pa.string() else (np.nan,)))
        else:
            raise NotARun(path, f"has no column {column}")
        if kind == pa.float64():
            values = found[column]
            wrong = values[(np.abs(values) > largest) & (np.isfinite(values) | (column not in UNBOUNDED))]
            if len(wrong):
                raise NotARun(path, f"is damaged: {column} holds {wrong[0]:.3g}")
    return found


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """All columns of a Parquet file, or those that it has. Raises NotARun where it is missing or damaged, TooLarge."""
    if not path.is_file():
        raise NotARun(path.parent, f"has no {path.name}")
    with reading(path, pa.ArrowException), pq.ParquetFile(path, page_checksum_verification=True) as parquet:
        names = parquet.schema_arrow.names
        there = names if columns is None else [name for name in columns if name in names]
        values = parquet.metadata.num_rows * len(there)
        if values > _MAX_VALUES:
            raise TooLarge(f"{path}: values", values, _MAX_VALUES)
        return parquet.read(columns=there)


def _to_numpy(path: Path, column: str, values: pa.ChunkedArray, kind: pa.DataType) -> NDArray[Any]:
    """One column (N,) as read_table gives it. Raises NotARun."""
    if values.type != kind:
        raise NotARun(path, f"has no column {column} of type {kind}")
    if values.null_count and kind != pa.float64():
        raise NotARun(path, f"is damaged: column {column} has missing values")
    with reading(path, pa.ArrowException):
        if kind == pa.string() or not len(values):
            return np.array(values.to_pylist(), _NUMPY[kind])
        # Not to_numpy or fill_null, which load pandas: half a second for commands that need nothing of it.
        found: NDArray[Any] = np.full(len(values), np.nan if kind == pa.float64() else 0, _NUMPY[kind])
        plain = values.cast(pa.uint8()) if kind == pa.bool_() else values
        valid = np.from_dlpack(values.is_valid().cast(pa.uint8()).combine_chunks())
        found[valid == 1] = np.from_dlpack(plain.drop_null().combine_chunks())
        return found


def _table(schema: pa.Schema, columns: Mapping[str, Any]) -> pa.Table:
    unknown = sorted(set(columns) - set(schema.names))
    missing = [name for name in schema.names if name not in columns and name not in OPTIONAL]
    if unknown or missing:
        raise ValueError(f"columns missing: {missing}, unknown: {unknown}")
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    shapes = {name: array.shape for name, array in arrays.items() if array.ndim}
    if len(set(shapes.values())) != 1 or len(next(iter(shapes.values()))) != 1:
        raise ValueError(f"columns must be one-dimensional and of one length, not {shapes}")
    ((rows,), *_) = shapes.values()
    return pa.table([_to_arrow(field, arrays.get(field.name), rows) for field in schema], schema=schema)


def _to_arrow(field: pa.Field, values: NDArray[Any] | None, rows: int) -> pa.Array:
    """One column, NaN as no value; never an int from a float, which would have lost nanoseconds on the way.

    From buffers: pa.array imports pandas, a third of a second, to see whether it has a Series.
    """
    if values is None and field.type != pa.string():
        return pa.nulls(rows, field.type)
    values = np.broadcast_to(np.array("") if values is None else values, rows)
    allowed = {pa.int64(): "iu", pa.float64(): "fiuO", pa.bool_(): "b", pa.string(): "UO"}[field.type]
    if rows and (values.dtype.kind not in allowed or (field.type == pa.int64() and values.dtype == np.uint64)):
        raise TypeError(f"{field.name}: {values.dtype} is no {field.type}")
    if field.type == pa.string():
        # File names may hold bytes that are no text; the table must not fail for it.
        texts = [text.encode("utf-8", "replace") for text in values.tolist()]
        ends = np.cumsum([0, *map(len, texts)], dtype=np.int32)
        return pa.Array.from_buffers(field.type, rows, [None, pa.py_buffer(ends), pa.py_buffer(b"".join(texts))])
    values = np.ascontiguousarray(values, _NUMPY[field.type])
    known = None if field.type != pa.float64() else ~np.isnan(values)
    missing = None if known is None or known.all() else pa.py_buffer(np.packbits(known, bitorder="little"))
    held = np.packbits(values, bitorder="little") if field.type == pa.bool_() else values
    return pa.Array.from_buffers(field.type, rows, [missing, pa.py_buffer(held)])


# The earliest instant of these, so that all figures share one time axis.
TIMED = ("ranges", "fixes", "poses", "target", "scans", "plans", "control")


def start_ns(run: Path) -> int:
    """The earliest instant of the run's tables, 0 without any; damaged ones, which raise when read, do not count."""
    found = []
    for name in TIMED:
        with suppress(NotARun, TooLarge):
            found.append(read_table(run, name, ["t_ns"])["t_ns"])
    return min((int(t_ns.min()) for t_ns in found if len(t_ns)), default=0)
