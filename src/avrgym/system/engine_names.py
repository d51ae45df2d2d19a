"""Names of the physics engines, as in the option ``--engine``."""

THREADS, WARP = "threads", "warp"
ENGINE_CHOICES = "threads, warp, or warp:DEVICE such as warp:cuda:1 or warp:cpu"
