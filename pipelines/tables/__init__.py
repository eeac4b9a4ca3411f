"""The papers' tables: their names, and the modules whose `table(fast, seed)` gives it."""

TABLES = {
    "following-uwb": "quadlog.pipelines.tables.following_uwb",
    "following-2": "quadlog.pipelines.tables.following_2",
    "planning-1": "quadlog.pipelines.tables.planning_1",
    "planning-2": "quadlog.pipelines.tables.planning_2",
    "planning-ea": "quadlog.pipelines.tables.planning_ea",
    "tracking-courses": "quadlog.pipelines.tables.tracking_courses",
    "tracking-5": "quadlog.pipelines.tables.tracking_5",
    "foot-torque": "quadlog.pipelines.tables.foot_torque",
    "foot-drift": "quadlog.pipelines.tables.foot_drift",
}
