"""What a recording holds: times, order, objects, the median interval of one object."""

import pytest

from dyknow.converters.recordings.overview import overview
from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.recordings.table_options import TableOptions
from dyknow.streams.time import SECOND


@pytest.fixture
def look(tmp_path):
    def read(text, **options):
        path = tmp_path / "s.csv"
        path.write_text(text)
        return overview(open_recording(path, TableOptions(time_unit="s", **options)))

    return read


def test_times_and_rate_of_one_object(look):
    found = look("time,x\n1,1\n2,1\n3,1\n7,1\n")
    assert (found.samples, found.first, found.last) == (4, SECOND, 7 * SECOND)
    assert (found.interval, found.rate) == (SECOND, 1.0)
    assert (found.out_of_order, found.time_column, found.has_available) == (0, "time", False)
    assert (found.id_field, found.objects) == (None, 0)


def test_the_interval_is_that_of_an_object(look):
    """Rows of two objects alternate; a row without id is of none."""
    found = look("time,id,x\n0,a,1\n1,b,1\n1,,2\n10,a,1\n11,b,1\n20,a,1\n")
    assert (found.id_field, found.objects) == ("id", 2)
    assert found.interval == 10 * SECOND


def test_an_id_may_be_a_number(look):
    found = look("time,mmsi,x\n0,0,1\n1,1,1\n2,0,1\n")
    assert (found.id_field, found.objects, found.interval) == ("mmsi", 2, 2 * SECOND)


def test_a_text_that_tells_samples_of_a_time_apart_names_the_objects(look):
    found = look("time,state,robot,x\n0,ok,a,1\n0,ok,b,1\n1,low,a,1\n1,ok,b,1\n")
    assert (found.id_field, found.objects, found.interval) == ("robot", 2, SECOND)
    alone = look("time,robot,x\n0,a,1\n1,b,1\n")  # times tell them apart: no reason to guess
    assert (alone.id_field, alone.objects) == (None, 0)
    twice = look("time,robot,x\n0,a,1\n0,a,1\n")
    assert (twice.id_field, twice.objects) == (None, 0)
    empty = look("time,robot,x\n0,a,1\n0,,1\n")
    assert (empty.id_field, empty.objects) == (None, 0)


def test_rows_out_of_order_are_counted_as_they_stand(look):
    found = look("time,x\n1,1\n3,1\n2,1\n4,1\n3,1\n")
    assert found.out_of_order == 2
    assert found.last == 4 * SECOND
    own = look("when,available,x\n1,5,1\n2,4,1\n", time_column="when")
    assert (own.out_of_order, own.time_column, own.has_available) == (1, "when", True)


def test_samples_of_one_time_have_no_rate(look):
    found = look("time,x\n1,1\n1,1\n")
    assert (found.interval, found.rate) == (None, None)
