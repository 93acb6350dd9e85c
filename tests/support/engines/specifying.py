"""The world of [Introspection15 Listing 1]: sources and transformations of a test ontology, and
short ways to write specifications."""

from dyknow.engine.engine import Engine
from dyknow.engine.processes.registry import Processes
from dyknow.streams.time import SECOND

NAMESPACE = "http://www.dyknow.eu/ontology#Specification"

ONTOLOGY = """
@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .

:self a dyknow:RMAX .
dyknow:RGB a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:double .
dyknow:IR a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:double .
dyknow:NearIR a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:double ;
    rdfs:subPropertyOf dyknow:IR .
dyknow:GPS a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:double ; :hasUnit "m" .
dyknow:GeoLocation a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:double ; :hasUnit "km" .
dyknow:PixelLocation a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:double .
"""

ANNOTATIONS = """
source gps provides fix:GPS [m]
source rgbCam provides picture:RGB
source irCam provides picture:IR
compunit GPSto3D transforms fix:GPS [km] to place:GeoLocation [km]
compunit fusionRGBIR transforms rgb:RGB(RMAX), ir:IR(RMAX)
  to pixel:PixelLocation(Human) for every Human = human
compunit project2Dto3D transforms pixel:PixelLocation(Human), place:GeoLocation(RMAX) [m]
  to location:GeoLocation(Human) [m]
"""


def listing_processes():
    """Cameras that see one human, a receiver that stands at 1000 m times ``scale``."""
    processes = Processes()

    @processes.sampled("float", "1s")
    def gps(time, *, scale=1.0):
        return 1000.0 * scale

    @processes.sampled("float", "1s")
    def rgbCam(time):
        return 20.0

    @processes.sampled("float", "1s")
    def irCam(time):
        return 3.0

    @processes.computational_unit("float", ["float"])
    def GPSto3D(time, samples, state, *, offset=0.0):
        (fix,) = samples
        return fix.value + offset, state

    @processes.computational_unit("pixel", ["float", "float"])
    def fusionRGBIR(time, samples, state):
        rgb, ir = samples
        return {"human": "human1", "pixel": rgb.value + ir.value}, state

    @processes.computational_unit("float", ["float", "float"])
    def project2Dto3D(time, samples, state):
        pixel, place = samples
        return pixel.value + place.value, state

    return processes


def world(data=None, processes=None, **settings):
    """An engine that knows all of Listing 1."""
    engine = Engine(data, epoch="test", processes=processes or listing_processes(), **settings)
    engine.load_ontology(ONTOLOGY, name="listing1")
    engine.annotate(ANNOTATIONS)
    return engine


def text(insertions="", removals=""):
    """A specification; elements have no prefix."""
    return (
        f'<specification xmlns="{NAMESPACE}">\n<insertions>{insertions}</insertions>\n'
        f"<removals>{removals}</removals>\n</specification>"
    )


def apply(engine, insertions="", removals=""):
    """Apply insertions and removals."""
    return engine.apply_specification(text(insertions, removals))


def run(engine, seconds, start=0):
    """Let the time go on."""
    for second in range(start, start + seconds):
        engine.tick(second * SECOND)


def units(engine):
    """The units that run: transformation, inputs and output of each, with the number of users."""
    return [
        (unit.transformation, tuple(s.name for s in unit.inputs), unit.output.name, unit.users)
        for unit in engine._parts.configuration.units.values()
    ]


def state(engine):
    """All that an engine is, as far as one can see it: streams, units, names, what is kept, what
    was told, and every triple."""
    configuration = engine._parts.configuration
    return (
        sorted(configuration.streams),
        units(engine),
        dict(configuration.aliases),
        sorted(configuration.named),
        [(view.name, view.unit, view.failure) for view in engine.insertions()],
        engine.ontology.registered.specifications(),
        sorted(map(str, engine.ontology.query_rows("SELECT * WHERE { ?s ?p ?o }")[1])),
        sorted(map(str, engine._parts.manager.assertions())),
        list(engine.generator("status").stream.all().rows()),
    )
