"""The arrays that the loops over tables of bits share.

``tables``    uint64 (tables, rows, words): a row a state, a bit an object. Four tables a node
              (`programs`), then those named in ``control``
``valid``     int64 (rows,): the valid times of the states; ``horizon``: as in `States`
``nodes``     int64 (nodes, fields): the program
``masks``     uint64 (domains, words): the columns in use; ``words``: int64 (domains,)
``full``      uint8 (nodes, rows): whether all objects are decided there
``stamp``     int64 (nodes, rows): the step in which the row changed last
``changed``   int64 (nodes, rows), ``changes`` int64 (nodes,): the rows changed in this step
``first``     int64 (nodes,): the first row that is not full
``closed``    int64 (nodes,): the first row whose interval may still get states
``spare``     uint64 (4, words): for a loop's own use; ``fresh`` int64 (2 rows,): the same
``control``   int64: numbers, at the places below
``out``       int64 (n, 6): verdicts: the valid times of the start, of the deciding state and of the
              witness or `TIME_MIN`, the row of the deciding state, the object, the value
"""

from __future__ import annotations

from typing import Final

CONTROLS: Final = 21
(
    STEP,  # the number of this step
    HOLDS,  # the first table of atoms' values, one an atom
    KNOWN,  # the first table of whether they are known
    PRESENT,  # the first table of objects that are there, one a domain
    DONE,  # the table of verdicts that are out
    NEWS,  # the table of verdicts of this step
    LOWER_T,  # the tables of the whole formula in both readings
    LOWER_F,
    UPPER_T,
    UPPER_F,
    ROOT_DOMAIN,  # the domain of verdicts
    OPEN,  # the first row with a verdict to come
    EMITTED,  # the verdicts in ``out``
    TRUES,  # true and unknown verdicts that are counted instead
    UNKNOWNS,
    REPORTS_ALL,  # whether these are in ``out``, too
    IS_WHOLE,  # whether row 0 is the first state of all
    LOOKS_BACK,  # whether rows before `OPEN` may still be needed
    IS_REPLAY,  # whether the verdicts of these states were given before
    FRESH,  # the rows in ``fresh``
    WAITING,  # their verdicts, which are not in ``out`` yet
) = range(CONTROLS)
