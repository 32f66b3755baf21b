"""From a user's own SMPL file (Loper et al. 2015) to a shape vector: a body of the same size and build.

Nothing of SMPL is in this package and none is needed. Who has a licence and the file gets people who measure like
its mesh: stature, mass, lengths of legs, shanks, arms and feet, widths of shoulders and hips.

>>> from footfall.models.body import describe
>>> from footfall.models.body.smpl import Smpl  # doctest: +SKIP
>>> body = describe(Smpl.read("SMPL_MALE.npz", "male").shape([1.5, -0.3]))  # doctest: +SKIP
"""

from __future__ import annotations

import pickle  # noqa: TID251  SMPL is published so; `_ArraysOnly` lets nothing but arrays in
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .anthropometry import shape_like
from .body import SHOULDER_SHARE

Array = NDArray[np.float64]

_SEX = {"female": 0.0, "neutral": 0.5, "male": 1.0}
_DENSITY = 1010.0  # kg/m^3 of the whole body (Siri 1961, at about 20 % of fat, with air in the lungs)
_JOINTS = [1, 4, 16, 18, 20]  # left hip, knee, shoulder, elbow, wrist in SMPL's order
_FOOT = 0.03  # of the stature: what is lower belongs to the feet
_KEYS = ("v_template", "shapedirs", "J_regressor", "f")


class SmplError(ValueError):
    """A file that is no SMPL body model, or shape parameters that it does not take."""


@dataclass(frozen=True)
class Smpl:
    """A body model of V vertices in SMPL's frame: m, x left, y up, z forward."""

    template: Array
    """(V, 3) vertices of the mean person in the T-pose."""
    directions: Array
    """(V, 3, B) what each shape parameter adds."""
    regressor: Array
    """(24, V) joints from vertices."""
    faces: NDArray[np.intp]
    """(F, 3) triangles."""
    male_fraction: float

    @classmethod
    def read(cls, path: Path | str, sex: Literal["female", "neutral", "male"] = "neutral") -> Smpl:
        """Read SMPL's .npz, or its .pkl, of which nothing but arrays is let in.

        Raises:
            SmplError: the file is no SMPL body model; says what is missing.
        """
        path = Path(path)
        try:
            fields = _read_npz(path) if path.suffix == ".npz" else _read_pickle(path)
            template, directions, regressor, faces = (fields[key] for key in _KEYS)
        except FileNotFoundError:
            raise
        except KeyError as error:
            raise SmplError(
                f"{path} is no SMPL body model: it has no {error}; {', '.join(_KEYS)} are needed."
            ) from error
        except (OSError, ValueError, BadZipFile, EOFError, AttributeError, pickle.UnpicklingError) as error:
            raise SmplError(f"{path} is no SMPL body model: {error}.") from error
        if sparse.issparse(regressor):
            regressor = regressor.toarray()
        count = len(template)
        shapes = template.shape, directions.shape[:2], regressor.shape, faces.shape[1:]
        if shapes != ((count, 3), (count, 3), (24, count), (3,)):
            raise SmplError(
                f"{path} is no SMPL body model: v_template {template.shape}, shapedirs {directions.shape}, J_regressor "
                f"{regressor.shape} and f {faces.shape} must be (V, 3), (V, 3, B), (24, V) and (F, 3)."
            )
        if sex not in _SEX:
            raise SmplError(f"the sex is female, male or neutral, not {sex!r}")
        template, directions, regressor = (np.asarray(x, float) for x in (template, directions, regressor))
        return cls(template, directions, regressor, np.asarray(faces, dtype=np.intp), _SEX[sex])

    def vertices(self, betas: ArrayLike = ()) -> Array:
        """(V, 3) of the person with those shape parameters, fewer than the model has or all of them.

        Raises:
            SmplError: too many, or not finite.
        """
        values = np.asarray(betas, dtype=float).reshape(-1)
        most = self.directions.shape[2]
        if len(values) > most or not np.isfinite(values).all():
            raise SmplError(f"betas must be at most {most} finite numbers, not {values}")
        return self.template + self.directions[..., : len(values)] @ values

    def shape(self, betas: ArrayLike = ()) -> Array:
        """The shape vector (10,) of a body that measures like the mesh (see `anthropometry.SHAPE_NAMES`).

        Raises:
            ShapeError: stature or mass are outside what is supported.
            SmplError: see `vertices`.
        """
        vertices = self.vertices(betas)
        sole, stature = vertices[:, 1].min(), float(np.ptp(vertices[:, 1]))
        hip, knee, shoulder, elbow, wrist = (self.regressor @ vertices - [0.0, sole, 0.0])[_JOINTS]
        foot = vertices[(vertices[:, 1] < sole + _FOOT * stature) & (vertices[:, 0] > 0)]
        return shape_like(
            stature,
            _DENSITY * volume(vertices, self.faces),
            self.male_fraction,
            hip_height=hip[1],
            knee_height=knee[1],
            arm=float(np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow)),
            biacromial=shoulder[0] / SHOULDER_SHARE,
            hip_half_width=hip[0],
            foot_length=float(np.ptp(foot[:, 2])),
        )


def volume(vertices: Array, faces: NDArray[np.intp]) -> float:
    """Volume, m^3, inside a closed mesh of triangles (F, 3) among vertices (V, 3)."""
    one, two, three = np.moveaxis(vertices[faces], 1, 0)
    return abs(float(np.einsum("fk,fk->", one, np.cross(two, three)))) / 6.0


def _read_npz(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as file:
        return {key: file[key] for key in _KEYS}


class _Array:
    """Stands for chumpy's arrays, which SMPL's pickles hold, without chumpy: keeps what it is given."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.x = state["x"]


class _ArraysOnly(pickle.Unpickler):
    """A pickle may run anything; this one builds arrays, sparse matrices and nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """See `pickle.Unpickler.find_class`."""
        if module.startswith("chumpy"):
            return _Array
        if module.startswith("scipy.sparse") and name in ("csc_matrix", "csr_matrix", "coo_matrix"):
            return getattr(sparse, name)
        if module.startswith("numpy") and name in (
            "ndarray",
            "dtype",
            "_reconstruct",
            "scalar",
            "_frombuffer",
        ):
            return super().find_class(module, name)
        if (module, name) == ("_codecs", "encode"):
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"it holds {module}.{name}, which is no array")


def _read_pickle(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        fields = _ArraysOnly(file, encoding="latin1").load()
    if not isinstance(fields, dict):
        raise SmplError(f"{path} is no SMPL body model: it holds no named fields.")
    return {key: value.x if isinstance(value, _Array) else value for key, value in fields.items()}
