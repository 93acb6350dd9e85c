"""JSON models of browser sessions."""

from __future__ import annotations

from pydantic import BaseModel, Field, SecretStr


class SessionIn(BaseModel):
    """The token to log in with."""

    token: SecretStr = Field(max_length=1000)


class SessionModel(BaseModel):
    """The caller; ``name`` is null without a token or session."""

    required: bool = Field(description="whether this service requires tokens")
    name: str | None = Field(description="the name of the token's owner")
    scopes: list[str] = Field(description="the permissions: read, publish, admin")
