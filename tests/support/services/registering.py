"""Queries and monitors, registered over HTTP."""

from __future__ import annotations

import httpx


def register(http: httpx.Client, text: str, **parameters: str) -> httpx.Response:
    headers = {"Content-Type": "text/plain"}
    return http.post("/queries", content=text, headers=headers, params=parameters)


def check_shared_until_the_last_has_left(
    http: httpx.Client, name: str, text: str, again: str
) -> None:
    """Register ``text`` and then ``again``, which is equal to it; ``name`` is the query's."""
    assert register(http, text).status_code == 201
    second = register(http, again)
    assert (second.status_code, second.json()["users"]) == (200, 2)
    assert [query["name"] for query in http.get("/queries").json()] == [name]
    assert http.delete(f"/queries/{name}").status_code == 204
    assert http.get(f"/queries/{name}").json()["users"] == 1
    assert http.delete(f"/queries/{name}").status_code == 204
    assert http.delete(f"/queries/{name}").status_code == 404
    assert http.get(f"/streams/{name}").status_code == 404
    assert http.get("/queries").json() == []
