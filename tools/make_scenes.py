"""Write the scenes that come with footfall: `python -m footfall.tools.make_scenes [FOLDER]`."""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import shapely

from ..models.scene import Flow, Groups, NewGoal, Obstacle, RandomPopulation, Scene, save_scene
from ..models.scene.scene import SHIPPED
from .make_slopes import slopes
from .scene_shapes import (
    bench,
    bollard,
    bus_shelter,
    cafe_table,
    car,
    covered,
    disc,
    litter_bin,
    outline,
    pole,
    rect,
    solid,
    tree,
)

RESOLUTION = 0.1


def crossing() -> Scene:
    """A main street (along x) meets a side street (along y); houses on three corners, a small park on one."""
    origin, cells = (-20.0, -20.0), (400, 400)
    whole = rect(-20, -20, 20, 20)
    main, side = rect(-20, -5.5, 20, 1.5), rect(-1, -20, 5, 20)
    kerb = 3.0  # radius of the kerb at the corners
    road = main.union(side).buffer(kerb).buffer(-kerb).union(main).union(side).intersection(whole)
    zebra = {
        "west": rect(-7.8, -5.5, -4.2, 1.5),
        "east": rect(8.2, -5.5, 11.8, 1.5),
        "north": rect(-1, 4.7, 5, 8.3),
        "south": rect(-1, -12.3, 5, -8.7),
    }
    crosswalk = shapely.union_all(list(zebra.values()))
    stripes = [rect(x, y, x + 3.6, y + 0.5) for x in (-7.8, 8.2) for y in np.arange(-5.3, 1.2, 1.0)]
    stripes += [rect(x, y, x + 0.5, y + 3.6) for y in (4.7, -12.3) for x in np.arange(-0.8, 4.9, 1.0)]
    stripes += [rect(x, -2.08, x + 1.5, -1.92) for x in (-19, -16, -13, -10, 13.5, 16.5)]
    stripes += [rect(1.92, y, 2.08, y + 1.5) for y in (-19, -16, -14, 10, 13, 16)]
    stripes += [rect(-8.9, -5.5, -8.5, -2), rect(12.5, -2, 12.9, 1.5)]
    stripes += [rect(-1, 9.0, 2, 9.4), rect(2, -13.4, 5, -13.0)]

    north_east = shapely.Polygon([(8.5, 20), (8.5, 7.5), (10.5, 5.5), (20, 5.5), (20, 20)])
    shops = shapely.Polygon([(-4.5, 20), (-4.5, 7), (-6, 5.5), (-11.5, 5.5), (-11.5, 20)])
    house = rect(-20, 5.5, -14.5, 20)  # a 3 m passage lies between the shops and the house
    cafe = shapely.Polygon(
        [(20, -12.5), (12, -12.5), (12, -9.5), (10, -9.5), (8.5, -11), (8.5, -20), (20, -20)]
    )
    hedge_w, hedge_e = rect(-18.5, -10.3, -13.5, -9.7), rect(-10.5, -10.3, -5.5, -9.7)
    hedge_s = rect(-5.5, -20, -4.9, -14.2)
    obstacles = [
        solid("department store", north_east, 14.0),
        solid("shops", shops, 11.0),
        solid("house", house, 9.0),
        solid("cafe", cafe, 8.0),
        solid("hedge", hedge_w, 1.1),
        solid("hedge", hedge_e, 1.1),
        solid("hedge", hedge_s, 1.1),
        solid("park pond", disc(-13.5, -16.0, 1.8, 12), 0.6),
        bench(-16.8, -12.2, 0),
        bench(-8.2, -12.2, 0),
        bench(-8.0, -17.5, 90),
        tree(-17.5, -14.5),
        tree(-9.5, -14.2),
        tree(-6.8, -12.0),
        tree(-17.0, -18.4),
        tree(-10.2, -18.6),
        bus_shelter(15.5, 4.3, 270),
        solid("timetable", rect(12.6, 2.1, 13.3, 2.3), 2.2),
        litter_bin(18.2, 4.8),
        litter_bin(-4.2, 2.6),
        litter_bin(6.4, -9.2),
        solid("post box", rect(7.7, 8.6, 8.2, 9.1), 1.3),
        solid("bicycle stand", rect(-11.0, 2.0, -8.6, 2.9), 1.0),
        solid("switch cabinet", rect(-14.2, -9.0, -13.2, -8.6), 1.2),
        solid("kiosk", rect(6.9, 13.2, 8.4, 15.7), 2.6),
        cafe_table(13.6, -11.2),
        cafe_table(16.0, -11.3),
        cafe_table(18.4, -11.1),
        tree(15.0, -6.4),
        tree(-15.5, -6.5),
        tree(-11.0, -6.5),
        tree(-17.0, 2.3),
        tree(-1.8, 14.0),
        tree(-1.8, 18.0),
        tree(5.8, 18.2),
        tree(5.8, -15.0),
        car(-14.0, 0.45, 0),
        car(16.6, -4.5, 0),
        car(0.0, -16.9, 90),
        *(pole(x, y, "traffic light") for x, y in ((-8.3, 2.0), (-3.7, -6.3), (7.7, 2.2), (12.3, -6.0))),
        *(pole(x, y, "traffic light") for x, y in ((-1.5, 8.8), (5.5, 4.2), (-1.5, -8.2), (5.5, -12.8))),
        *(pole(x, y) for x, y in ((-19.2, 2.1), (19.3, 2.1), (19.2, -6.1), (-7.2, -6.2), (-1.6, -18.9))),
        *(bollard(x, y) for x, y in ((-2.7, 3.0), (-3.4, 2.35), (6.7, 3.0), (7.3, 2.5))),
        *(bollard(x, y) for x, y in ((-2.7, -7.1), (-3.3, -6.6), (6.7, -7.1), (7.4, -6.5))),
    ]
    green = rect(-20, -20, -4.9, -9.7)
    pavement = whole.difference(road).difference(shapely.union_all([north_east, shops, house, cafe]))
    layers = {
        "walkable": pavement.union(road),
        "road": road,
        "crosswalk": crosswalk,
        "pavement": pavement.difference(green),
        "green": green,
        "marking": shapely.union_all(stripes),
    }
    areas = {
        "west_end_north": rect(-19.7, 3.2, -16.4, 5.3),
        "west_end_south": rect(-19.7, -9.2, -16.2, -6.9),
        "east_end_north": rect(13.6, 1.9, 19.0, 3.3),
        "east_end_south": rect(15.8, -10.2, 19.7, -6.3),
        "north_end_west": rect(-4.3, 15.8, -2.3, 19.7),
        "north_end_east": rect(6.3, 16.3, 8.3, 19.7),
        "south_end_west": rect(-4.7, -19.7, -2.2, -15.5),
        "south_end_east": rect(6.4, -19.7, 8.3, -15.9),
        "bus_stop": rect(13.8, 3.6, 17.2, 4.6),
        "park": rect(-12.6, -14.2, -8.6, -10.9),
        "passage": rect(-14.2, 14.0, -11.8, 19.5),
        "store_door": rect(8.8, 3.5, 11.5, 5.2),
    }
    flows = [
        ("west_end_north", "south_end_east", 1.5),
        ("west_end_south", "north_end_east", 1.5),
        ("east_end_south", "north_end_west", 1.5),
        ("south_end_west", "bus_stop", 1.5),
        ("north_end_west", "park", 1.0),
        ("north_end_east", "west_end_south", 1.0),
        ("park", "store_door", 1.0),
        ("bus_stop", "south_end_west", 1.0),
        ("passage", "east_end_south", 1.0),
        ("store_door", "south_end_west", 1.0),
        ("south_end_east", "west_end_north", 1.0),
        ("east_end_north", "passage", 0.5),
    ]
    return Scene(
        name="crossing",
        description="Street corner with crosswalks on all four arms, shops, a bus stop, a cafe and a park.",
        resolution=RESOLUTION,
        origin=origin,
        layers={name: covered(shape, cells, RESOLUTION, origin) for name, shape in layers.items()},
        obstacles=tuple(obstacles),
        areas={name: outline(shape) for name, shape in areas.items()},
        population=RandomPopulation(
            count=20,
            flows=tuple(Flow(*flow) for flow in flows),
            enter_over=6.0,
            groups=Groups(share=0.4, sizes={2: 3.0, 3: 1.0}),
        ),
    )


def plaza() -> Scene:
    """A town square: fountain in the middle, houses around it, streets entering at the corners and sides."""
    origin, cells = (-15.0, -15.0), (300, 300)
    whole = rect(-15, -15, 15, 15)
    houses = {
        "town hall": rect(-8, 12.5, 8, 15),
        "bank": rect(-15, 9, -13, 15).union(rect(-15, 12.5, -11.5, 15)),
        "chemist": rect(11.5, 12.5, 15, 15).union(rect(13, 7, 15, 15)),
        "bakery": rect(12.7, -9, 15, 3.5),
        "inn": rect(-15, -9.5, -12.8, 5.5),
        "library": rect(-15, -15, -4, -12.6),
        "cinema": rect(1, -15, 11, -12.8),
    }
    lawns = [disc(x, y, 2.3, 12) for x, y in ((-7.2, -7.2), (7.2, -7.2), (-7.2, 7.0), (7.2, 7.0))]
    columns = [disc(x, 11.3, 0.28, 8) for x in np.linspace(-7, 7, 6)]
    seats = [
        bench(4.9 * np.cos(a), 4.9 * np.sin(a), float(np.degrees(a)) + 90.0)
        for a in np.radians([45.0, 135.0, 225.0, 315.0])
    ]
    obstacles = [
        *(solid(name, shape, 10.0) for name, shape in houses.items()),
        solid("fountain", disc(0, 0, 2.6, 16), 0.7),
        *(solid("planted bed", lawn, 0.5) for lawn in lawns),
        *(solid("arcade column", column, 4.0) for column in columns),
        *seats,
        solid("newspaper kiosk", disc(-9.8, 1.8, 1.3, 8), 2.8),
        solid("flower stall", rect(8.6, -1.6, 10.4, 1.4), 2.5),
        *(cafe_table(x, y) for x in (-11.6, -9.6) for y in (-8.6, -6.2, -3.8) if x < -10 or y > -5),
        *(tree(x, -10.6, 0.45) for x in (-9.0, -5.0, 5.0, 9.0)),
        *(tree(x, 9.4, 0.45) for x in (-4.5, 4.5)),
        solid("statue", rect(-0.7, 6.3, 0.7, 7.7), 3.5),
        solid("advertising column", disc(11.0, 4.6, 0.6, 8), 3.2),
        *(litter_bin(x, y) for x, y in ((-5.8, 3.4), (5.9, -3.4), (1.9, -10.9))),
        *(pole(x, y) for x, y in ((-3.6, -7.5), (3.6, -7.5), (-3.6, 7.6), (3.6, 7.6))),
        *(bollard(x, -14.2) for x in (-2.9, -1.5, -0.1)),
        solid("bicycle stand", rect(10.9, -10.5, 11.9, -7.7), 1.0),
    ]
    built = shapely.union_all(list(houses.values()))
    green = shapely.union_all(lawns)
    areas = {
        "south_street": rect(-3.7, -13.9, 0.7, -12.0),
        "south_east_street": rect(11.4, -14.7, 14.7, -11.4),
        "east_street": rect(12.2, 3.9, 14.7, 6.7),
        "north_east_street": rect(8.4, 12.2, 11.2, 14.7),
        "north_west_street": rect(-11.2, 12.2, -8.4, 14.7),
        "west_street": rect(-14.7, 5.9, -12.2, 8.7),
        "south_west_street": rect(-14.7, -12.2, -12.0, -9.9),
        "town_hall_steps": rect(-6.0, 11.7, 6.0, 12.4),
        "fountain_side": rect(-1.8, -4.6, 1.8, -3.2),
        "kiosk_front": rect(-8.2, 0.8, -6.8, 2.8),
        "flower_stall_front": rect(6.8, -1.2, 8.1, 1.0),
        "cinema_door": rect(4.0, -12.3, 8.0, -11.5),
    }
    flows = [
        ("south_street", "town_hall_steps", 2.0),
        ("south_street", "north_east_street", 1.0),
        ("south_east_street", "north_west_street", 2.0),
        ("east_street", "west_street", 1.5),
        ("north_east_street", "south_west_street", 1.5),
        ("north_west_street", "cinema_door", 1.0),
        ("west_street", "flower_stall_front", 1.0),
        ("south_west_street", "fountain_side", 1.0),
        ("town_hall_steps", "south_street", 1.0),
        ("fountain_side", "east_street", 1.0),
        ("cinema_door", "kiosk_front", 1.0),
        ("kiosk_front", "south_east_street", 1.0),
    ]
    layers = {
        "walkable": whole.difference(built),
        "pavement": whole.difference(built).difference(green),
        "green": green,
    }
    return Scene(
        name="plaza",
        description="Town square with a fountain, planted beds, benches, kiosks, cafe tables and an arcade.",
        resolution=RESOLUTION,
        origin=origin,
        layers={name: covered(shape, cells, RESOLUTION, origin) for name, shape in layers.items()},
        obstacles=tuple(obstacles),
        areas={name: outline(shape) for name, shape in areas.items()},
        population=RandomPopulation(
            count=25,
            flows=tuple(Flow(*flow) for flow in flows),
            speed_mean=1.2,
            enter_over=8.0,
            groups=Groups(share=0.5, sizes={2: 3.0, 3: 1.0, 4: 0.5}),
        ),
        events=(NewGoal(12.0, 0, "kiosk_front"), NewGoal(16.0, 3, "fountain_side")),
    )


def corridor() -> Scene:
    """A 20 m long, 6 m wide corridor that two streams of fifteen walk through against each other."""
    origin = (-12.0, -3.5)
    cells = (70, 240)
    pilasters = [rect(x - 0.2, 2.8, x + 0.2, 3.0) for x in (-5.0, 0.0, 5.0)]
    pilasters += [rect(x - 0.2, -3.0, x + 0.2, -2.8) for x in (-5.0, 0.0, 5.0)]
    obstacles: list[Obstacle] = [
        solid("north wall", rect(-12, 3.0, 12, 3.5), 3.0),
        solid("south wall", rect(-12, -3.5, 12, -3.0), 3.0),
        *(solid("pilaster", pilaster, 3.0) for pilaster in pilasters),
        solid("drinks machine", rect(2.2, 2.4, 3.1, 3.0), 1.9),
        solid("bench", rect(-3.4, -3.0, -1.6, -2.6), 0.5),
    ]
    return Scene(
        name="corridor",
        description="Corridor, 20 x 6 m, with two opposing streams of fifteen people each.",
        resolution=RESOLUTION,
        origin=origin,
        layers={"walkable": covered(rect(-12, -3, 12, 3), cells, RESOLUTION, origin)},
        obstacles=tuple(obstacles),
        areas={
            "west_end": outline(rect(-11.8, -2.6, -8.0, 2.6)),
            "east_end": outline(rect(8.0, -2.6, 11.8, 2.6)),
        },
        population=RandomPopulation(
            count=30,
            flows=(Flow("west_end", "east_end"), Flow("east_end", "west_end")),
            enter_over=12.0,
            groups=Groups(share=0.2, sizes={2: 1.0}),
        ),
    )


MAKERS: dict[str, Callable[[], Scene]] = {
    "crossing": crossing,
    "plaza": plaza,
    "corridor": corridor,
    "slopes": slopes,
}


def main(argv: list[str] | None = None) -> int:
    """Write every shipped scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=SHIPPED, help="where to (launch/scenes)")
    folder = parser.parse_args(argv).folder
    for name, make in MAKERS.items():
        print(save_scene(make(), folder / name))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
