"""Events of the shipped templates mean what their comments say."""

import pytest
from feeding import feed, samples

from dyknow.engine.model.views import Since
from dyknow.templates.library import shipped_texts

ALTITUDES = "stream flights contains altitude(UAV) = alt [ft] for every UAV = id"


@pytest.fixture
def low(engine):
    """The valid times (s) of the events of flights with these altitudes: of one object, the time
    and the altitude of each sample."""

    def events(*flown):
        engine.annotate(ALTITUDES)
        feed(engine, "flights", [(t, {"id": "uav1", "alt": alt}) for t, alt in flown])
        engine.register_template(shipped_texts()["low_altitude"])
        request = engine.parse_request("dyknow:LowAltitudeEvent(?o, dyknow:UAV, 1000)")
        view = engine.request_event(request, since=Since.START)
        engine.end("flights")
        return [t for t, values in samples(engine, view.stream)]

    return events


def every_second(*altitudes):
    return [(float(t), alt) for t, alt in enumerate(altitudes, start=1)]


def test_low_for_the_whole_window(low):
    assert low(*every_second(900, 900, 900, 900, 900, 900, 2000, 900)) == [5, 6]


def test_the_rest_of_a_window_at_the_end_of_the_data_is_no_event(low):
    assert low(*every_second(2000, 2000, 900, 900, 900, 900)) == []


def test_neither_is_the_first_sample_nor_one_after_a_gap(low):
    assert low((1.0, 900), (20.0, 900), (21.0, 900)) == []


def test_samples_may_be_somewhat_late(low):
    assert low((1.2, 900), (2.1, 900), (2.9, 900), (4.0, 900), (4.9, 900)) == [5, 6]
