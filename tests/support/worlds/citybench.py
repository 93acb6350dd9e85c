"""CityBench replayed: the recorded sensors of Aarhus as timed triples, as its README maps them.

Each row and each property that its sensor `ssn:observes` makes an observation with an IRI of its
own: its class, the stream it is observed by, the property and the value. All files are read from
the shared data; nothing of CityBench is in the project.
"""

from __future__ import annotations

import csv
import gzip
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path

import pyoxigraph
import rdflib
from pyoxigraph import Literal, NamedNode
from shared_data import DATA

FOLDER = DATA / "citybench"
SERVICE = "http://www.insight-centre.org/dataset/SampleEventService#"
CT = "http://www.insight-centre.org/citytraffic#"
SSN = "http://purl.oclc.org/NET/ssnx/ssn#"
SAO = "http://purl.oclc.org/NET/sao/"
SECOND = 1_000_000_000
_TYPE = NamedNode("http://www.w3.org/1999/02/22-rdf-syntax-ns#type")
_OBSERVATION = NamedNode(SSN + "Observation")
_OBSERVED_BY = NamedNode(SSN + "observedBy")
_OBSERVED_PROPERTY = NamedNode(SSN + "observedProperty")
_HAS_VALUE = NamedNode(SAO + "hasValue")

TimedTriple = tuple[int, NamedNode, NamedNode, NamedNode | Literal]
Row = Mapping[str, str]


@dataclass(frozen=True)
class Schedule:
    """Record n of the stream with number i arrives at ``i * offset + n * period`` (ns)."""

    period: int
    offset: int


def query(number: int) -> str:
    """A query of the benchmark, as it is."""
    return (FOLDER / "queries" / f"Q{number}.txt").read_text()


def sensor_repository(folder: Path) -> Path:
    """The sensors' descriptions, unpacked into ``folder``."""
    path = folder / "SensorRepository.ttl"
    path.write_bytes(gzip.decompress((FOLDER / "static" / "SensorRepository.n3.gz").read_bytes()))
    return path


def cultural_events() -> Path:
    return FOLDER / "static" / "AarhusCulturalEvents.rdf"


def replayed(
    names: Sequence[str], schedule: Schedule, records: int
) -> dict[str, list[TimedTriple]]:
    """The first ``records`` records of each stream, by the stream's IRI."""
    return {
        SERVICE + name: [
            (index * schedule.offset + number * schedule.period, *triple)
            for number, row in enumerate(islice(rows(name), records))
            for triple in observations(name, number, row)
        ]
        for index, name in enumerate(names)
    }


def rows(name: str) -> Iterator[Row]:
    with gzip.open(FOLDER / "streams" / f"{name}.stream.gz", "rt", encoding="utf-8") as file:
        if name == "UserLocationService":
            for line in file:
                user, _, place = line.strip().partition("|")
                latitude, _, longitude = place.partition(",")
                yield {"user": user, "lat": latitude, "lon": longitude}
        else:
            yield from csv.DictReader(file)


def observations(name: str, number: int, row: Row) -> Iterator[tuple]:
    """The triples of one record."""
    for position, (observed, kind) in enumerate(observes()[name]):
        value = _VALUES.get(kind)
        if value is None:
            continue
        node = NamedNode(f"{SERVICE}{name}-{number}-{position}")
        yield node, _TYPE, _OBSERVATION
        yield node, _OBSERVED_BY, NamedNode(SERVICE + name)
        yield node, _OBSERVED_PROPERTY, observed
        if kind == "Location":
            place = NamedNode(f"{node.value}-place")
            yield node, _HAS_VALUE, place
            yield place, NamedNode(CT + "hasLatitude"), Literal(float(row["lat"]))
            yield place, NamedNode(CT + "hasLongitude"), Literal(float(row["lon"]))
        else:
            yield node, _HAS_VALUE, value(row)
        if kind == "ParkingVacancy":
            return  # "first property only"


@cache
def observes() -> dict[str, list[tuple[NamedNode, str]]]:
    """By sensor, its properties and the local name of each one's class."""
    data = gzip.decompress((FOLDER / "static" / "SensorRepository.n3.gz").read_bytes())
    triples = list(pyoxigraph.parse(data, format=pyoxigraph.RdfFormat.TURTLE))
    kinds = {
        t.subject: t.object.value.removeprefix(CT)
        for t in triples
        if t.predicate == _TYPE and t.object.value.startswith(CT)
    }
    found: dict[str, list[tuple[NamedNode, str]]] = {}
    for t in triples:
        if t.predicate.value == SSN + "observes" and t.object in kinds:
            sensor = t.subject.value.removeprefix(SERVICE)
            found.setdefault(sensor, []).append((t.object, kinds[t.object]))
    return found


@cache
def distances() -> dict[str, float]:
    """By report, the length of its road in metres."""
    with (FOLDER / "static" / "trafficMetaData.csv").open(encoding="utf-8") as file:
        return {row["REPORT_ID"]: float(row["DISTANCE_IN_METERS"]) for row in csv.DictReader(file)}


def _ratio(numerator: float, divisor: float) -> float:
    return numerator / divisor if divisor else -1.0


_VALUES: dict[str, Callable[[Row], Literal]] = {
    "AvgSpeed": lambda row: Literal(float(row["avgSpeed"])),
    "VehicleCount": lambda row: Literal(float(row["vehicleCount"])),
    "MeasureTime": lambda row: Literal(float(row["avgMeasuredTime"])),
    "EstimatedTime": lambda row: Literal(
        _ratio(distances()[row["REPORT_ID"]], float(row["avgSpeed"]))
    ),
    "CongestionLevel": lambda row: Literal(
        _ratio(float(row["vehicleCount"]), distances()[row["REPORT_ID"]])
    ),
    "ParkingVacancy": lambda row: Literal(int(row["totalspaces"]) - int(row["vehiclecount"])),
    "Temperature": lambda row: Literal(float(row["tempm"])),
    "Humidity": lambda row: Literal(float(row["hum"])),
    "WindSpeed": lambda row: Literal(float(row["wspdm"])),
    "Location": lambda row: Literal(row["user"]),
}


def touched(names: Sequence[str]) -> rdflib.Graph:
    """The static triples that can matter to the streams ``names``: for a definition that is slow.

    Every variable of the queries that is asked of SensorRepository is a property that one of the
    streams observes (an observation joins it) or what that is a property of. Cultural events are
    joined by distance only, so all of them stay.
    """
    graph = rdflib.Graph().parse(cultural_events())
    data = gzip.decompress((FOLDER / "static" / "SensorRepository.n3.gz").read_bytes())
    sensors = rdflib.Graph().parse(data, format="turtle")
    for name in names:
        for observed, _ in observes()[name]:
            property = rdflib.URIRef(observed.value)
            for triple in sensors.triples((property, None, None)):
                graph.add(triple)
                for more in sensors.triples((triple[2], None, None)):
                    graph.add(more)
    return graph
