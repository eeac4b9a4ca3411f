"""Maps and queries that other tools wrote: MovingAI's benchmarks, and what ROS map_server reads."""
