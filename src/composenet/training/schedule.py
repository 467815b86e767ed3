"""The learning rate over a run that is bounded in time."""


def scheduled_rate(
    peak: float, warmup_steps: int, decay_share: float, steps_done: int, run_share: float
) -> float:
    """Warm-up over the first steps of all, constant, then linear to a hundredth over the last
    decay_share of the run, so that every run ends with usable weights. run_share: 0..1."""
    rate = peak * min(1.0, (steps_done + 1) / warmup_steps)
    if decay_share > 0:
        rate *= min(1.0, max(0.01, (1 - run_share) / decay_share))
    return rate
