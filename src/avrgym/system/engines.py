"""Names of the physics engines."""

THREADS, WARP = "threads", "warp"
ENGINES = "threads, warp, or warp:DEVICE such as warp:cuda:1 or warp:cpu"
