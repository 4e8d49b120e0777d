"""A sweep cut into scenes and blocks, the same way whatever the number of ranks.

A scene is a set of trajectories that differ in their starts alone and in Stokes numbers of one
decade (like cost): same body, flow, instants and tolerance. A scene that fills blocks is cut into
them in the order of its trajectories; scenes that do not are gathered, where one integration can
hold them: same instants, polynomial flows, bodies of like slenderness. What a block holds follows
from the case alone. Scenes and blocks are numbered and made when they are asked for; nothing here
grows with the number of trajectories but a few numbers per scene.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.case.document import assigned
from qbxstokes.case.load import LoadedCase
from qbxstokes.case.sweep import Column
from qbxstokes.case.values import Key
from qbxstokes.geometry.registry import SHAPE_KEYS
from qbxstokes.quantities import COLUMNS, MEASURED
from qbxstokes.runs.plan import NO_AXIS, NO_ZEROS, MotionPlan, make_plan, subject_to_forces
from qbxstokes.runs.sweep_layout import Block, BodyScenes, CoupledScenes, Swept
from qbxstokes.simulation.from_case import samples_of
from qbxstokes.typing import Integers

STOKES: Key = ("body", "stokes_number")
_POSITION: Key = ("start", "position")
_MOVING = {_POSITION, ("start", "velocity")}
_PUSHING = {"forces", "constraints"}
# Sections that a sweep has no use for, and what it has in their place.
_SINGLE = {
    "events": "a sweep takes periods and averages from the samples; leave it out",
    "field": "draw the field of one trajectory as a motion of its own",
}
# What one block may hold in memory while its quantities are computed (bytes).
BLOCK_BYTES = 64 * 2**20
# Blocks that a rank can hold the order of, and what each costs.
MOST_BLOCKS = 10_000_000
# Numbers held per sample of a trajectory: its state and the quantities, with copies under way.
_NUMBERS_PER_SAMPLE = 100


@dataclass(frozen=True)
class Scene:
    """What the trajectories of one scene share: a case (of its first trajectory) and its plan."""

    number: int
    loaded: LoadedCase
    plan: MotionPlan


class Scenes(Swept):
    """All scenes and blocks of a sweep of motions."""

    nouns = "trajectory", "trajectories"

    def __init__(self, loaded: LoadedCase) -> None:
        super().__init__(loaded)
        self._time = loaded.case.time
        for name, right in _SINGLE.items():
            if getattr(loaded.case, name) != type(loaded.case).declared[name].default:
                raise loaded.error(name, "belongs to a single motion, not to a sweep", right)
        self.samples = samples_of(loaded)
        if self._time.at is None:  # one number for all, where the case leaves it open
            data = assigned(loaded.document.data, ("time", "samples"), self.samples)
            self.loaded = replace(loaded, document=replace(loaded.document, data=data))
        section = loaded.case.sweep
        most = BLOCK_BYTES // (8 * _NUMBERS_PER_SAMPLE * self.samples)
        self.block_size = max(1, min(section.block, most))
        self.alone = section.measure is not None
        if section.measure is not None:
            self.block_size, self.turns = 1, 1 + section.measure.repeats
        self._latest: Scene | None = None
        self._classes = [self._classes_of(axis) for axis in range(len(self.space.axes))]
        self.shape = tuple(len(classes) for classes in self._classes)
        self.size = math.prod(self.shape)
        self.blocks = int(self._pieces[0][-1]) + 1
        first, times = self.scene(0).plan, {"time", "flow", "start", *SHAPE_KEYS}
        self.columns = COLUMNS | MEASURED if self.alone else COLUMNS
        self.quantities = first.quantities if section.store == "samples" else ()
        varied = {part for _, c in self.space.columns if self._makes_scene(c) for part in c.key[:2]}
        if not varied & (times if self._time.periods is not None else {"time"}):
            self.common_times = first.times
        self.skips = tuple(text for text in first.skips if text not in (NO_AXIS, NO_ZEROS))
        if self.centred:
            self.skips += ("translation: no body leaves its place in a flow that is odd about it",)

    @cached_property
    def sizes(self) -> Integers:
        """Trajectories per scene."""
        sizes = np.ones((), dtype=np.int64)
        for classes in self._classes:
            sizes = np.multiply.outer(sizes, [len(points) for points in classes])
        return sizes.ravel()

    @cached_property
    def _pieces(self) -> tuple[Integers, Integers, Integers]:
        """Of every piece its block, its scene, and where in the scene it begins; block by block.

        Scenes that fill blocks are cut into pieces that are one each; of the others several share
        one, gathered in their order.
        """
        whole = (self._companies < 0) | (self.sizes >= self.block_size)
        counts = np.where(whole, -(-self.sizes // self.block_size), 0)
        if (count := int(counts.sum())) > MOST_BLOCKS:
            wrong = f"has {self.space.size:g} trajectories in {count:g} blocks"
            right = f"at most {MOST_BLOCKS:g} blocks: several sweeps"
            raise self.loaded.error("sweep", wrong, right)
        cut, small = np.repeat(np.arange(self.size), counts), np.flatnonzero(~whole)
        begins = np.arange(count) - np.repeat(np.cumsum(counts) - counts, counts)
        shared: list[int] = []
        latest: dict[int, tuple[int, int]] = {}  # company -> its open block, and what is in it
        for scene in small.tolist():
            company, size = int(self._companies[scene]), int(self.sizes[scene])
            block, held = latest.get(company, (-1, self.block_size))
            if held + size > self.block_size:
                block, held, count = count, 0, count + 1
            shared.append(block)
            latest[company] = block, held + size
        order = np.argsort(shared, kind="stable")
        return (
            np.concatenate([np.arange(len(cut)), np.array(shared, dtype=np.int64)[order]]),
            np.concatenate([cut, small[order]]),
            np.concatenate([begins * self.block_size, np.zeros(len(small), dtype=np.int64)]),
        )

    def _pieces_of(self, number: int) -> slice:
        return slice(*np.searchsorted(self._pieces[0], [number, number + 1]))

    def block(self, number: int) -> Block:
        """A block by its number, the trajectories of each piece in increasing order."""
        _, scenes, begins = (held[self._pieces_of(number)].tolist() for held in self._pieces)
        pieces = zip(scenes, begins, strict=True)
        return Block(number, tuple((scene, self.members(scene, begin)) for scene, begin in pieces))

    def block_sizes(self) -> Integers:
        """Trajectories per block."""
        blocks, scenes, begins = self._pieces
        held = np.minimum(self.sizes[scenes] - begins, self.block_size)
        return np.bincount(blocks, held).astype(np.int64)

    def scene_of_block(self) -> Integers:
        """First scene of every block."""
        blocks, scenes, _ = self._pieces
        return np.asarray(scenes[np.unique(blocks, return_index=True)[1]])

    def scenes_of(self, number: int) -> list[int]:
        """Scenes that a block holds trajectories of."""
        return [int(scene) for scene in self._pieces[1][self._pieces_of(number)]]

    def members(self, scene: int, begin: int = 0) -> Integers:
        """Numbers of the trajectories of a scene from its `begin`-th on, those of one block."""
        chosen, end = self._chosen(scene), min(begin + self.block_size, int(self.sizes[scene]))
        local = np.unravel_index(np.arange(begin, end), tuple(len(points) for points in chosen))
        points = tuple(
            where if isinstance(list_of, range) else list_of[where]
            for list_of, where in zip(chosen, local, strict=True)
        )
        return np.asarray(np.ravel_multi_index(points, self.space.shape), dtype=np.int64)

    def _chosen(self, scene: int) -> list[Any]:
        """Points of every axis that a scene is of."""
        places = np.unravel_index(scene, self.shape)
        return [classes[place] for classes, place in zip(self._classes, places, strict=True)]

    def scene(self, number: int) -> Scene:
        """A scene by its number; raises QbxStokesError where the case cannot be computed."""
        if self._latest is not None and self._latest.number == number:
            return self._latest
        loaded = self.loaded.at([int(points[0]) for points in self._chosen(number)])
        self._latest = Scene(number, loaded, make_plan(loaded, pushed=self.pushed))
        return self._latest

    @cached_property
    def pushed(self) -> bool:
        """Whether forces enter any motion of the sweep: its bodies serve every Stokes number."""
        columns = [column for _, column in self.space.columns]
        if any(column.key[0] in _PUSHING for column in columns):
            return True
        stokes = [c.take(np.arange(c.size)) for c in columns if c.key == STOKES]
        if any(np.any(values) for values in stokes):
            return True
        return subject_to_forces(self.loaded.case)

    @cached_property
    def centred(self) -> bool:
        """Whether no body leaves its place, as far as the first trajectory tells for all.

        Blocks then integrate the rotation alone (`motion.centred`).
        """
        swept = {column.key[:2] for _, column in self.space.columns}
        scene = self.scene(0)
        case, flow = scene.loaded.case, scene.loaded.flow.polynomial
        pushed = self.loaded.case.forces.given or self.loaded.case.constraints.given
        moving = case.start.velocity != "with_flow" and any(case.start.velocity)
        if pushed or moving or swept & _MOVING or {key[0] for key in swept} & _PUSHING:
            return False
        if flow is None or scene.plan.simulation.kind != "table":
            return False
        return bool(flow.odd_about(scene.plan.simulation.position[0]))

    # -- which values make a scene ------------------------------------------------------------

    def _classes_of(self, axis: int) -> list[Any]:
        """Points of one axis, grouped by what makes a scene."""
        columns = [c for c in self.space.axes[axis] if self._makes_scene(c)]
        size = self.space.shape[axis]
        if not columns:
            return [range(size)] if size > 10**7 else [np.arange(size)]
        points = np.arange(size)
        labels = list(zip(*(self._labels(column, points) for column in columns), strict=True))
        groups: dict[tuple[str, ...], list[int]] = {}
        for point, label in enumerate(labels):
            groups.setdefault(label, []).append(point)
        return [np.array(members) for members in groups.values()]

    @staticmethod
    def _labels(column: Column, points: Integers) -> list[str]:
        """What tells the values of a column apart as scenes."""
        values = column.take(points)
        if column.key == STOKES:
            return ["" if v == 0 else str(math.floor(math.log10(v))) for v in values.tolist()]
        return [json.dumps(value) for value in values.tolist()]

    def _makes_scene(self, column: Column) -> bool:
        """Whether trajectories with different values cannot be integrated together."""
        if column.key[: len(_POSITION)] != _POSITION:
            return column.key[0] != "start"
        # Jeffery's period is the same everywhere in a flow of a uniform gradient.
        degree = self.loaded.flow.degree
        words = any(c.key[0] == "flow" and not c.numeric for _, c in self.space.columns)
        return self._time.periods is not None and (degree is None or degree > 1 or words)

    # -- which scenes may share a block -------------------------------------------------------

    @cached_property
    def _companies(self) -> Integers:
        """Of every scene the number of those it may share a block with, -1 for none."""
        scene = self.scene(0)
        if scene.plan.simulation.kind != "table":
            return np.full(self.size, -1)
        return self._alike(self._makes_scene, self._company_labels)

    def _alike(
        self, counts: Callable[[Column], bool], labels: Callable[[Column, Integers], list[str]]
    ) -> Integers:
        """Of every scene a number, the same where the labels of all columns that count are."""
        per_axis = []
        for axis, classes in zip(self.space.axes, self._classes, strict=True):
            first = np.array([int(points[0]) for points in classes])
            told = [labels(column, first) for column in axis if counts(column)]
            names = list(zip(*told, strict=True)) if told else [()] * len(classes)
            known: dict[tuple[str, ...], int] = {}
            per_axis.append([known.setdefault(name, len(known)) for name in names])
        sizes = tuple(max(ids) + 1 for ids in per_axis)
        grids = np.meshgrid(*per_axis, indexing="ij")
        return np.asarray(np.ravel_multi_index(tuple(grid.ravel() for grid in grids), sizes))

    def _company_labels(self, column: Column, points: Integers) -> list[str]:
        """What tells the values of a column apart where trajectories are to share a block."""
        key = column.key
        own_times = self._time.periods is not None and key[0] in ("flow", "start", "body")
        sized = column.numeric and key[0] in ("body", "flow", "forces")
        if key == STOKES or own_times or not sized:
            return self._labels(column, points)
        sizes = np.abs(column.take(points)).reshape(len(points), -1).max(axis=1)
        if key[0] == "body":
            # Steps grow with the slenderness: bodies within a factor of four are alike.
            with np.errstate(divide="ignore"):
                sizes = np.maximum(sizes, 1.0 / sizes)
            return [str(math.floor(math.log(value, 4.0))) if value < 1e9 else "" for value in sizes]
        return [str(math.floor(math.log10(value))) if value > 0 else "" for value in sizes]

    # -- bodies ---------------------------------------------------------------------------------

    @cached_property
    def bodies(self) -> tuple[Integers, list[int]]:
        """Body of every scene, and a scene for each body.

        Scenes with the same body share one operator: same shape, discretisation and kind of flow.
        """
        number = self._alike(_changes_body, self._labels)
        _, representatives, body = np.unique(number, return_index=True, return_inverse=True)
        return body, [int(i) for i in representatives]


def _changes_body(column: Column) -> bool:
    """Whether a column makes operators or functionals differ."""
    if column.key[0] == "flow":
        # The numbers of a named flow leave its kind (polynomial or not) as it is.
        return not column.numeric
    first, second = (*column.key[:2], None)[:2]
    return first == "hydrodynamics" or (first == "body" and second in SHAPE_KEYS)


def swept_scenes(loaded: LoadedCase) -> Swept:
    """The scenes of a sweep: of motions, of bodies, or of bodies that share a fluid."""
    if loaded.case.coupled:
        return CoupledScenes(loaded)
    return BodyScenes(loaded) if loaded.case.task == "body" else Scenes(loaded)
