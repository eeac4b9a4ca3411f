"""The names of quadlog's own planners, alone in their file: importing the planners loads their compiled cores."""

PLANNER_NAMES = (
    *("astar", "astar_paper", "ia_star", "ia_star_bounded", "ea_star", "clearance_astar"),
    *("d_star_lite", "mt_d_star_lite", "lpa_star", "ara_star", "dijkstra"),
)
