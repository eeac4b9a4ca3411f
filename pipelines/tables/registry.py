"""Every table that `quadlog tables` makes: its name, and the module whose `make_table(fast, seed)` gives it."""

from __future__ import annotations

TABLES = {
    "following-uwb": "quadlog.pipelines.tables.following_uwb",
    "following-lidar": "quadlog.pipelines.tables.following_lidar",
}
