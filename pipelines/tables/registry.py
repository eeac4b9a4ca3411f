"""Every table that `quadlog tables` makes: its name, and the module whose `make_table(fast, seed)` gives it."""

from __future__ import annotations

TABLES = {
    "following-uwb": "quadlog.pipelines.tables.following.uwb_table",
    "following-lidar": "quadlog.pipelines.tables.following.lidar_table",
    "following-2": "quadlog.pipelines.tables.following.table_2",
    "planning-1": "quadlog.pipelines.tables.planning.table_1",
    "planning-2": "quadlog.pipelines.tables.planning.table_2",
    "planning-ea": "quadlog.pipelines.tables.planning.ea_star",
    "tracking-courses": "quadlog.pipelines.tables.tracking.courses",
    "tracking-5": "quadlog.pipelines.tables.tracking.table_5",
    "foot-torque": "quadlog.pipelines.tables.foot.torque",
    "foot-drift": "quadlog.pipelines.tables.foot.drift",
    "uwb-real": "quadlog.pipelines.tables.real.uwb_real",
}
