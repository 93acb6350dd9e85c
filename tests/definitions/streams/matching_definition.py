"""Semantic matching by its definition: docs/explanation/design/0003-semantic-matching.md,
"Definitions".

[Introspection15 §4.3], SPEC §7. Slow on purpose: every path is walked, every plan is listed. It
shares nothing with the product but the values that stand for what is asked for and what there is.

Where the text leaves it open:

- Features in different units, or for sorts with other bounds, are different goals.
- "At most one is every S, and the output keeps it apart" is of inputs that meet: a unit of one
  kind of subjects may run for many that its output does not tell apart.
- Streams "speak of" each argument of what they hold; outputs of transformations of their arguments.
- Arguments of the output beyond what is wanted are bound like those that occur only in inputs.
- A variable has one sort. Where the output finds objects itself, all inputs have arguments.
- Equal units that serve two goals are one; streams of one synchronization are all its inputs'.
"""

from collections import namedtuple
from itertools import product

from dyknow.ontology.units import UnitError, conversion
from dyknow.ontology.vocabulary import SELF, THING
from dyknow.rdf.namespaces import OWL, STREAM_SPACE

TOPS = {THING, OWL + "Thing", STREAM_SPACE + "Sort"}

Subject = namedtuple("Subject", "sort object bounds", defaults=((),))
"""Every object of ``sort``, not beyond ``bounds``; or ``object``, said to be of ``sort``."""

Goal = namedtuple("Goal", "asks subjects")
"""Features that are needed together, of the same subjects. An ask is (feature, unit or None)."""

InStream = namedtuple("InStream", "stream roles fields selections")
"""Where ``roles`` stand in a stream: a content for each ask, and {(id field, object)} to select."""

ByUnit = namedtuple("ByUnit", "transformation binding kinds selections")
"""``kinds``: ((goal, input numbers), …); ``binding``: ((variable, subject), …)."""

InParts = namedtuple("InParts", "goals")
"""Goals that share out the features: some that a stream holds together, the others alone."""


class TooMuch(Exception):
    """More steps than a test can wait for."""


class Definition:
    """What may be had from a space. ``budget``: steps, at most (`TooMuch`)."""

    def __init__(self, space, vocabulary, budget=200_000, favoured=None):
        self.streams = list(space.streams.values())
        self.transformations = list(space.transformations.values())
        self.vocabulary = vocabulary
        self.favoured = favoured or {}
        self.budget = budget
        self.known_answers = {}

    def step(self):
        self.budget -= 1
        if self.budget < 0:
            raise TooMuch

    # -- subjects --------------------------------------------------------------------------

    def name(self, object):
        return self.vocabulary.self_object if object == SELF else object

    def within(self, sub, sup):
        return sup in TOPS or sub == sup or self.vocabulary.is_subsort(sub, sup)

    def belongs(self, subject, sort):
        """The ontology knows it to be of the sort or of a sub-sort, or the asker said so."""
        if subject.object is None:
            return self.within(subject.sort, sort)
        known = self.vocabulary.sorts_of(subject.object)
        said = {subject.sort} if subject.sort is not None else set()
        return sort in TOPS or any(self.within(each, sort) for each in known | said)

    def bounded(self, subject, sort):
        """``subject`` below a transformation for ``sort``. Of bounds the narrowest say all."""
        if subject.object is not None or sort in TOPS:
            return subject
        bounds = {*subject.bounds, sort}
        narrowest = {b for b in bounds if not any(c != b and self.within(c, b) for c in bounds)}
        return subject._replace(bounds=tuple(sorted(narrowest)))

    def holds(self, role, subject):
        """What has ``role`` has all of ``subject``, and nothing that may not be there."""
        if role.object is not None:
            return subject.object == role.object
        if subject.object is not None:
            return self.belongs(subject, role.sort)
        return self.within(subject.sort, role.sort) and all(
            self.within(role.sort, bound) for bound in subject.bounds
        )

    def all_hold(self, roles, subjects):
        """Roles beyond the subjects may be any."""
        return len(roles) >= len(subjects) and all(map(self.holds, roles, subjects))

    # -- features --------------------------------------------------------------------------

    def serves(self, feature, unit, ask):
        """The feature or a sub-feature of it, in a unit that converts."""
        wanted, wanted_unit = ask
        if wanted != feature and wanted not in self.vocabulary.superfeatures(feature):
            return False
        try:
            return wanted_unit is None or bool(conversion(unit, wanted_unit))
        except UnitError:
            return False

    def spoken_of(self, features):
        """Whom streams and outputs that lead to ``features`` speak of, what is nearer first."""
        found, waiting = {}, sorted(features)
        for feature in waiting:
            for case in self.cases(feature):
                for stream in self.streams:
                    for content in stream.contents:
                        if content.feature == case:
                            found |= {Subject(r.sort, r.object): None for r in content.roles}
            for t in self.giving(feature):
                for a in t.arguments:
                    found[Subject(a.sort, a.object and self.name(a.object))] = None
                waiting += [p.feature for p in t.inputs if p.feature not in waiting]
        return list(found)

    def cases(self, feature):
        """The feature, then its sub-features."""
        return [feature, *sorted(self.vocabulary.subfeatures(feature) - {feature})]

    def giving(self, feature):
        """Transformations of the feature itself, then of sub-features."""
        return [
            t
            for case in self.cases(feature)
            for t in self.transformations
            if t.output.feature == case
        ]

    # -- answers ---------------------------------------------------------------------------

    def answers(self, goal):
        """All answers of a goal, in the order of trying."""
        self.step()
        if goal not in self.known_answers:
            found = [*self.in_streams(goal.asks, goal.subjects)]
            found += self.by_units(goal.asks, goal.subjects)
            if len(goal.asks) > 1:
                found += self.in_parts(goal)
            self.known_answers[goal] = found
        return self.known_answers[goal]

    def in_streams(self, asks, subjects):
        """Streams of several wants, then of the features themselves, then of the object itself,
        then of the sort wanted or near to it, then in order."""
        found = []
        for place, stream in enumerate(self.streams):
            first = [c for c in stream.contents if self.serves(c.feature, c.unit, asks[0])]
            first.sort(key=lambda content: content.feature != asks[0][0])
            for roles in dict.fromkeys(content.roles for content in first):
                contents = tuple(self.content_for(ask, stream, roles) for ask in asks)
                if roles and None not in contents and self.all_hold(roles, subjects):
                    answer = InStream(stream.name, roles, contents, selections(roles, subjects))
                    others = sum(c.feature != a[0] for c, a in zip(contents, asks, strict=True))
                    own = roles[0].object is not None and roles[0].object == subjects[0].object
                    rank = (
                        -self.favoured.get(stream.name, 0),
                        others,
                        not own,
                        self.generality(roles[0].sort, subjects[0].sort),
                        place,
                    )
                    found.append((rank, answer))
        return [answer for _, answer in sorted(found, key=lambda pair: pair[0])]

    def generality(self, sort, wanted):
        """Sorts that are between the wanted one and ``sort``."""
        above = self.vocabulary.supersorts(wanted or THING)
        return len(above - self.vocabulary.supersorts(sort)) if sort in above else 0

    def content_for(self, ask, stream, roles):
        """The feature itself before sub-features, else in order."""
        contents = [
            content
            for content in stream.contents
            if content.roles == roles and self.serves(content.feature, content.unit, ask)
        ]
        return min(contents, key=lambda content: content.feature != ask[0], default=None)

    def by_units(self, asks, subjects):
        """Units whose output is all that is asked for."""
        for t in self.giving(asks[0][0]):
            if not t.lacks and all(self.serves(t.output.feature, t.output.unit, a) for a in asks):
                for binding in self.bindings(t, subjects):
                    kinds = self.kinds(t, binding, subjects)
                    if kinds is not None:
                        yield ByUnit(t.name, binding, kinds, self.generated(t, subjects))

    def bindings(self, t, subjects):
        """Every way to say what the arguments of ``t`` are: ((variable, subject), …)."""
        if not t.arguments:
            return [()]
        if len(t.arguments) < len(subjects):
            return []
        bound = {}
        for argument, subject in zip(t.arguments, subjects, strict=False):
            if argument.object is not None:
                if subject.object != self.name(argument.object):
                    return []
            elif not self.belongs(subject, argument.sort):
                return []
            elif argument.id_field is None:
                if bound.setdefault(argument.variable, subject) != subject:
                    return []
            elif not all(self.within(argument.sort, bound) for bound in subject.bounds):
                return []
        ways = [bound]
        for variable in free_variables(t, bound):
            who = self.who(t, variable, subjects)
            ways = [{**way, variable: subject} for way in ways for subject in who]
        return [tuple(way.items()) for way in ways]

    def who(self, t, variable, subjects):
        """``self`` first, then who is spoken of on the way to the features of ``variable``."""
        features, sorts = set(), set()
        for port in t.inputs:
            for argument in arguments_of(t, port):
                if argument.variable == variable:
                    features.add(port.feature)
                    sorts.add(argument.sort)
        own = Subject(None, self.vocabulary.self_object)
        found = dict.fromkeys(as_said(each, subjects) for each in [own, *self.spoken_of(features)])
        return [who for who in found if all(self.belongs(who, sort) for sort in sorts)]

    def kinds(self, t, binding, subjects):
        """What the inputs need: ((goal, input numbers), …); None if many would meet many."""
        bound = dict(binding)
        needs = {}
        for number, port in enumerate(t.inputs):
            arguments = arguments_of(t, port)
            meant = (self.meant(t, argument, bound) for argument in arguments)
            whose = tuple(each and as_said(each, subjects) for each in meant) or subjects
            if None in whose:
                return None
            # Two variables that mean every UAV are not the same UAV; one object is one object.
            many = [a.variable for a, s in zip(arguments, whose, strict=False) if s.object is None]
            needs.setdefault((tuple(many), whose), []).append(number)
        of_many = {many for many, _ in needs if many}
        kept = {a.variable for a in t.arguments if a.id_field is None}
        if len(needs) > 1 and (len(of_many) > 1 or not all(set(m) <= kept for m in of_many)):
            return None
        return tuple(
            (Goal(asks_of(t, numbers), whose), tuple(numbers))
            for (_, whose), numbers in needs.items()
        )

    def meant(self, t, argument, bound):
        """Whose feature an input is, not beyond any sort that the variable has in ``t``."""
        if argument.object is not None:
            return Subject(None, self.name(argument.object))
        subject = bound[argument.variable]
        for port in (*t.inputs, t.output):
            for other in arguments_of(t, port):
                if other.variable == argument.variable:
                    if not self.belongs(subject, other.sort):
                        return None
                    subject = self.bounded(subject, other.sort)
        return subject

    def generated(self, t, subjects):
        """What is to be selected from the objects that the unit finds itself."""
        return frozenset(
            (argument.id_field, subject.object)
            for argument, subject in zip(t.arguments, subjects, strict=False)
            if argument.id_field is not None and subject.object is not None
        )

    def in_parts(self, goal):
        """As much as possible in one stream and the rest alone; last everything alone."""
        together = {}
        for ask in goal.asks:
            for stream in self.in_streams((ask,), goal.subjects):
                asks = self.held_with(stream, goal.asks)
                if 1 < len(asks) < len(goal.asks):
                    together[asks] = None
        for asks in (*sorted(together, key=len, reverse=True), ()):
            alone = [(ask,) for ask in goal.asks if ask not in asks]
            shares = [asks, *alone] if asks else alone
            yield InParts(tuple(Goal(share, goal.subjects) for share in shares))

    def held_with(self, answer, asks):
        """All of ``asks`` that stand where ``answer`` does."""
        stream = next(s for s in self.streams if s.name == answer.stream)
        return tuple(ask for ask in asks if self.content_for(ask, stream, answer.roles))

    # -- plans -----------------------------------------------------------------------------

    def has_plan(self, goal, path=()):
        """Some answer's goals all have one, none of which needs what stands on the path."""
        self.step()
        return goal not in path and any(
            all(self.has_plan(need, (*path, goal)) for need in needs_of(answer))
            for answer in self.answers(goal)
        )

    def plans(self, goals):
        """Every plan for all of ``goals``: {goal: answer} of the goals it uses."""

        def extend(choice, waiting):
            self.step()
            if not waiting:
                yield choice
                return
            goal, *rest = waiting
            if goal in choice:
                yield from extend(choice, rest)
                return
            for answer in self.answers(goal):
                longer = {**choice, goal: answer}
                if not needs_itself(longer, goal):
                    yield from extend(longer, [*needs_of(answer), *rest])

        yield from extend({}, list(goals))

    def depth_first(self, goal, chosen, path=()):
        """*fast*: the first answer whose goals are answered; an answered goal keeps its answer."""
        self.step()
        if goal in chosen:
            return True
        if goal in path:
            return False
        for answer in self.answers(goal):
            if all(self.depth_first(need, chosen, (*path, goal)) for need in needs_of(answer)):
                chosen[goal] = answer
                return True
        return False

    # -- what plans weigh ------------------------------------------------------------------

    def made(self, goal, choice, apart=False):
        """Where each ask of a goal stands if it is made as was chosen: (node, roles, field).

        A node is a tuple: a stream, or a unit with all that it reads. Equal ones are one unit.
        ``apart``: inputs of different subjects are synchronized even where one stream has both.
        """
        match choice[goal]:
            case InStream(stream, roles, contents, selected):
                node = ("stream", stream)
                for role in roles:
                    for field, object in sorted(selected):
                        if field == role.id_field:
                            node = ("select", node, field, object)
                return [(node, roles, content.field) for content in contents]
            case InParts(shares):
                found = {}
                for share in shares:
                    found |= dict(zip(share.asks, self.made(share, choice, apart), strict=True))
                return [found[ask] for ask in goal.asks]
            case ByUnit(name, _, kinds, selected):
                (t,) = (t for t in self.transformations if t.name == name)
                edges = {}
                for kind, (need, numbers) in enumerate(kinds):
                    found = dict(zip(need.asks, self.made(need, choice, apart), strict=True))
                    for port in (t.inputs[number] for number in numbers):
                        node, roles, field = found[port.feature, port.unit]
                        edge = (node, roles, kind if apart else None)
                        edges.setdefault(edge, []).append((field, port.field, port.unit))
                inputs = tuple((n, r, frozenset(fields)) for (n, r, _), fields in edges.items())
                if len(inputs) > 1:
                    inputs = (("synchronize", *inputs),)
                node = ("unit", name, *inputs)
                for field, object in sorted(selected):
                    node = ("select", node, field, object)
                return [(node, None, t.output.field)] * len(goal.asks)

    def units(self, goals, choice, apart=False):
        """The distinct units and streams of a plan."""
        found, waiting = set(), [n for goal in goals for n, _, _ in self.made(goal, choice, apart)]
        while waiting:
            node = waiting.pop()
            found.add(node)
            waiting += below(node)
        return found

    def least(self, goals, weight, apart=False):
        """The least sum, over all plans, of the weights of their distinct units and streams."""
        return min(sum(map(weight, self.units(goals, plan, apart))) for plan in self.plans(goals))

    def best(self, goal, quality):
        """The best quality, over all plans, of what was wanted. ``quality``: a node's own."""

        def of(node):
            return quality(node) * min(map(of, below(node)), default=1.0)

        return max(of(self.made(goal, plan)[0][0]) for plan in self.plans([goal]))

    # -- how much --------------------------------------------------------------------------

    def whole(self, want):
        info = self.vocabulary.feature(want.feature)
        ask = (want.feature, None if info is None else info.unit)
        if want.object is None:
            first = Subject(want.sort or THING, None)
        else:
            first = Subject(want.sort, self.name(want.object))
        others = (
            Subject(s.sort if s.object or s.sort else THING, s.object and self.name(s.object))
            for s in want.others
        )
        subjects = (first, *others)
        return Goal((ask,), tuple(as_said(subject, subjects) for subject in subjects))

    def parts(self, want):
        """The parts of a want that are tried, as goals."""
        whole = self.whole(want)
        spoken_of = self.spoken_of([want.feature])
        choices = []
        for wanted in whole.subjects:
            parts = [self.part(held, wanted) for held in spoken_of]
            choices.append(dict.fromkeys([wanted, *filter(None, parts)]))
        found = {}
        for each in product(*choices):
            found[tuple(as_said(subject, each) for subject in each)] = None
        return [Goal(whole.asks, each) for each in found if each != whole.subjects]

    def part(self, held, wanted):
        """ "Narrower sorts, single objects, or an unknown object taken to be of a sort"."""
        wanted_sort = wanted.sort or THING
        if held.object is not None:
            alone = Subject(None, held.object)
            if wanted.object is not None:
                return alone if held.object == wanted.object else None
            return alone if self.belongs(alone, wanted_sort) else None
        if not self.within(held.sort, wanted_sort):
            return None
        if wanted.object is None:
            return Subject(held.sort, None)
        known = self.vocabulary.sorts_of(wanted.object) - TOPS
        if self.belongs(wanted, held.sort):
            return None
        if known and not any(self.within(held.sort, each) for each in known):
            return None
        return Subject(held.sort, wanted.object)

    def covers(self, wider, narrower):
        if wider.object is None:
            return self.belongs(narrower, wider.sort)
        if wider.object != narrower.object:
            return False
        return wider.sort is None or (
            narrower.sort is not None and self.within(narrower.sort, wider.sort)
        )

    def supplied(self, want):
        """(goals that are supplied, complete): one for the whole, or those of parts."""
        whole = self.whole(want)
        if self.has_plan(whole):
            return [whole], True
        found = [part for part in self.parts(want) if self.has_plan(part)]
        return self.widest(found), False

    def widest(self, goals):
        """Of parts that cover each other the first is taken."""

        def covers(wider, narrower):
            return all(map(self.covers, wider.subjects, narrower.subjects))

        def is_covered(i, goal):
            return any(
                covers(other, goal) and (k < i or not covers(goal, other))
                for k, other in enumerate(goals)
                if k != i
            )

        return [goal for i, goal in enumerate(goals) if not is_covered(i, goal)]


# -- what ports speak of -------------------------------------------------------------------


def as_said(subject, subjects):
    """What the asker said of an object holds wherever it is spoken of; if twice, the first."""
    same = [s for s in subjects if s.object and s.object == subject.object]
    return next((s for s in same if s.sort), same[0] if same else subject)


def arguments_of(t, port):
    """ "Ports without arguments speak of what the others speak of"."""
    return port.arguments or t.arguments


def free_variables(t, bound):
    """Variables of inputs whose objects are not given by what is wanted."""
    variables = [a.variable for port in t.inputs for a in arguments_of(t, port) if a.sort]
    return [variable for variable in dict.fromkeys(variables) if variable not in bound]


def asks_of(t, numbers):
    """What these inputs ask for, each once."""
    return tuple(dict.fromkeys((t.inputs[n].feature, t.inputs[n].unit) for n in numbers))


def selections(roles, subjects):
    """{(id field, object)}: the one asked for of many, and that which a condition names."""
    found = set()
    for place, role in enumerate(roles):
        object = role.object
        if object is None and place < len(subjects):
            object = subjects[place].object
        if object is not None and role.id_field is not None:
            found.add((role.id_field, object))
    return frozenset(found)


def needs_of(answer):
    """The goals that an answer needs."""
    match answer:
        case InStream():
            return ()
        case ByUnit():
            return tuple(goal for goal, _ in answer.kinds)
        case InParts():
            return answer.goals


def below(node):
    """What a node of `Definition.made` reads."""
    match node:
        case ("stream", _) | ("unit", _):
            return ()
        case ("select", source, _, _):
            return (source,)
        case ("unit", _, ("synchronize", *_) as source):
            return (source,)
        case ("unit", _, (source, _, _)):
            return (source,)
        case ("synchronize", *edges):
            return tuple(source for source, _, _ in edges)


def needs_itself(choice, goal):
    """A chosen goal stands below itself, as far as choices were made."""
    seen, waiting = set(), list(needs_of(choice[goal]))
    while waiting:
        need = waiting.pop()
        if need == goal:
            return True
        if need in choice and need not in seen:
            seen.add(need)
            waiting += needs_of(choice[need])
    return False
