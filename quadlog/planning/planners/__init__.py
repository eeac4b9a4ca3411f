"""The planners, a file for each family; their names, a line each as a plug-in's entry point is written, import none."""

PLANNER_CLASSES = {
    "astar": "quadlog.planning.planners.astar:AStar",
    "astar_paper": "quadlog.planning.planners.astar:AStarPaper",
    "ia_star": "quadlog.planning.planners.ia_star:IAStar",
    "ia_star_end": "quadlog.planning.planners.ia_star:IAStarEnd",
    "ia_star_bounded": "quadlog.planning.planners.ia_star:IAStarBounded",
    "ea_star": "quadlog.planning.planners.ea_star:EAStar",
    "clearance_astar": "quadlog.planning.planners.ea_star:ClearanceAStar",
    "d_star_lite": "quadlog.planning.planners.d_star_lite:DStarLite",
    "mt_d_star_lite": "quadlog.planning.planners.d_star_lite:MTDStarLite",
    "lpa_star": "quadlog.planning.planners.d_star_lite:LPAStar",
    "dijkstra": "quadlog.planning.planners.astar:Dijkstra",
}
PLANNER_NAMES = tuple(PLANNER_CLASSES)
