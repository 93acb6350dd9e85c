"""Sessions of browsers as JSON."""

from __future__ import annotations

from pydantic import BaseModel, Field, SecretStr


class SessionIn(BaseModel):
    """What somebody logs in with."""

    token: SecretStr = Field(max_length=1000)


class SessionModel(BaseModel):
    """Who asks: ``name`` is null where nobody has said."""

    required: bool = Field(description="whether this service wants tokens")
    name: str | None = Field(description="whose token it is")
    scopes: list[str] = Field(description="what it allows: read, publish, admin")
