"""The base of all sections of a launch description."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A section of the description: unknown keys, infinities and NaN are refused; it is frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
