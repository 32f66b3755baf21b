"""Figures printed in the tables of Rempe et al. 2023, as rows that stand beside ours."""

Row = dict[str, str | float | None]

_METRICS = ("obstacle", "agent", "emd_vel", "emd_lon", "emd_lat")


def _row(figures: tuple[float | None, ...], names: tuple[str, ...], **labels: str | float) -> Row:
    return {**labels, **dict(zip(names, figures, strict=True))}


def _table_1(guide: str, method: str, *figures: float | None) -> Row:
    return _row(figures, ("error", *_METRICS), guide=guide, method=f"paper: {method}")


TABLE_1 = [
    _table_1("none", "VAE", None, 0.076, 0.118, 0.038, 0.039, 0.040),
    _table_1("none", "TRACE", None, 0.050, 0.132, 0.029, 0.008, 0.009),
    _table_1("obstacle", "VAE", 0.018, 0.018, 0.116, 0.040, 0.036, 0.039),
    _table_1("obstacle", "filter", 0.018, 0.018, 0.123, 0.019, 0.011, 0.015),
    _table_1("obstacle", "noisy", 0.015, 0.015, 0.125, 0.021, 0.012, 0.017),
    _table_1("obstacle", "TRACE", 0.014, 0.014, 0.124, 0.020, 0.011, 0.017),
    _table_1("agent", "VAE", 0.010, 0.075, 0.010, 0.041, 0.038, 0.039),
    _table_1("agent", "filter", 0.049, 0.050, 0.049, 0.031, 0.012, 0.013),
    _table_1("agent", "noisy", 0.000, 0.056, 0.000, 0.035, 0.013, 0.012),
    _table_1("agent", "TRACE", 0.000, 0.058, 0.000, 0.025, 0.010, 0.012),
    _table_1("waypoint", "VAE", 0.078, 0.051, 0.092, 0.070, 0.031, 0.033),
    _table_1("waypoint", "filter", 0.333, 0.046, 0.112, 0.044, 0.013, 0.013),
    _table_1("waypoint", "noisy", 0.129, 0.052, 0.110, 0.067, 0.038, 0.033),
    _table_1("waypoint", "TRACE", 0.105, 0.048, 0.093, 0.057, 0.013, 0.014),
    _table_1("all", "VAE", 0.207, 0.021, 0.015, 0.053, 0.032, 0.032),
    _table_1("all", "filter", 0.527, 0.023, 0.096, 0.025, 0.014, 0.016),
    _table_1("all", "noisy", 0.236, 0.022, 0.017, 0.057, 0.025, 0.022),
    _table_1("all", "TRACE", 0.211, 0.021, 0.009, 0.036, 0.007, 0.009),
]

TABLE_5 = [
    _row(figures, ("ade", "fde", *_METRICS), method=f"paper: {method}")
    for method, figures in {
        "VAE": (0.340, 0.774, 0.062, 0.115, 0.041, 0.038, 0.039),
        "TRACE-Raster": (0.337, 0.808, 0.052, 0.100, 0.027, 0.013, 0.014),
        "TRACE-Global": (0.280, 0.686, 0.056, 0.094, 0.022, 0.013, 0.016),
        "TRACE": (0.318, 0.757, 0.046, 0.110, 0.028, 0.020, 0.020),
    }.items()
]

TABLE_6 = [
    _row(figures, ("ade", "fde", *_METRICS), method="paper: TRACE", data=data, drop=drop)
    for (data, drop), figures in {
        ("maps", 0.1): (0.351, 0.819, 0.040, 0.112, 0.030, 0.023, 0.024),
        ("maps, interact", 0.0): (0.303, 0.719, 0.042, 0.123, 0.028, 0.019, 0.020),
        ("maps, interact", 0.05): (0.307, 0.712, 0.040, 0.108, 0.024, 0.020, 0.023),
        ("maps, interact", 0.1): (0.318, 0.757, 0.046, 0.110, 0.028, 0.020, 0.020),
    }.items()
]

TABLE_7 = [
    _row(figures, _METRICS, w=w, method="paper: TRACE")
    for w, figures in {
        0.0: (0.051, 0.131, 0.019, 0.012, 0.014),
        0.3: (0.051, 0.130, 0.027, 0.008, 0.010),
        0.5: (0.050, 0.132, 0.029, 0.008, 0.009),
        0.7: (0.050, 0.132, 0.033, 0.009, 0.008),
        1.0: (0.049, 0.130, 0.040, 0.010, 0.009),
        2.0: (0.051, 0.132, 0.063, 0.017, 0.015),
    }.items()
]

TABLE_2 = [
    _row(figures, ("error", "lon", "lat"), guide=guide, method=f"paper: {method}")
    for (guide, method), figures in {
        ("waypoint", "VAE"): (0.340, 0.193, 0.172),
        ("waypoint", "TRACE, w 0"): (0.551, 0.159, 0.145),
        ("waypoint", "TRACE, w -0.5"): (0.366, 0.140, 0.132),
        ("perturbed", "VAE"): (0.962, 0.443, 0.441),
        ("perturbed", "TRACE, w 0"): (1.129, 0.233, 0.218),
        ("perturbed", "TRACE, w -0.5"): (0.802, 0.212, 0.204),
        ("groups", "VAE"): (0.297, 0.109, 0.104),
        ("groups", "TRACE, w 0"): (0.244, 0.110, 0.101),
        ("groups", "TRACE, w -0.5"): (0.245, 0.094, 0.087),
    }.items()
]

TABLE_8 = [
    _row(figures, ("error", "lon", "lat"), w=w, method="paper: TRACE")
    for w, figures in {
        0.0: (1.129, 0.233, 0.218),
        -0.3: (0.972, 0.213, 0.199),
        -0.5: (0.802, 0.212, 0.204),
        -0.7: (0.670, 0.240, 0.233),
        -1.0: (0.546, 0.345, 0.348),
    }.items()
]
