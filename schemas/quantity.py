"""A number of a file that a person writes, with its standard deviation."""

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


class Quantity(BaseModel):
    """A number with its standard deviation, both in the unit of the key."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    value: float
    sd: float = Field(default=0.0, ge=0.0)


def quantity(default_sd: float = 0.0, default_share: float = 0.0) -> BeforeValidator:
    """A number alone has the default sd, or that share of it."""

    def widen(raw: Any) -> Any:
        if isinstance(raw, (int, float)) and not isinstance(raw, bool):
            return {"value": raw, "sd": default_sd + default_share * abs(raw)}
        if not isinstance(raw, (dict, Quantity)):
            raise ValueError("give a number without a unit, or { value = …, sd = … }")
        return raw

    return BeforeValidator(widen, json_schema_input_type=float | Quantity)


Exact = Annotated[Quantity, quantity()]
Length = Annotated[Quantity, quantity()]
Inertia = Annotated[Quantity, quantity(default_share=0.05)]
"""Nobody weighs an inertia: a number alone is taken to 5 %."""
Taped = Annotated[Quantity, quantity(0.02)]
"""Between the CGs, the hitch and the implement's axle, as for where a receiver is: a number alone is taken to
2 cm. In sharp turns 5 cm do what half of the implement tyres' stiffness does."""
Weighed = Annotated[Quantity, quantity(default_share=0.02)]
"""A number alone is taken to 2 %."""
Placed = Annotated[Quantity, quantity(0.05)]
"""The middle of something large: a number alone is taken to 5 cm."""
