"""The JSON models of requests and responses, by resource. Times are ISO-8601 in UTC, durations are
texts such as ``5s``."""

from .annotations import AnnotationModel
from .events import EventIn, EventModel, PlanModel, TemplateModel, UnitModel
from .kpl import DeclarationModel, OneDeclarationModel, RemovedModel
from .matching import MatchIn, MatchModel
from .parts import BEGINNING, Since, Strategy, schema_of, text_schema
from .queries import QueryModel
from .reasoning import MatchesWhyModel, PartialMatchesModel, WhyModel
from .session import SessionIn, SessionModel
from .specifications import InsertionModel, SpecificationModel
from .state import (
    ExplainModel,
    HealthModel,
    OntologyModel,
    OntologyReportModel,
    StatusModel,
    ViolationModel,
    WaitingModel,
)
from .streams import (
    AcceptedModel,
    CountersModel,
    EvaluationModel,
    FieldModel,
    RetentionModel,
    StreamIn,
    StreamModel,
)
from .subscriptions import (
    AdaptiveModel,
    RematchModel,
    SubscriptionIn,
    SubscriptionModel,
)
from .transformations import (
    ContentsIn,
    PortModel,
    QualityIn,
    TransformationIn,
    TransformationModel,
    WorthIn,
)

READ_BY_ROUTES = (EventIn, TransformationIn, ContentsIn)
"""Models of bodies that their routes parse: the framework cannot, as other media types are possible
there."""

__all__ = [
    "BEGINNING",
    "READ_BY_ROUTES",
    "AcceptedModel",
    "AdaptiveModel",
    "AnnotationModel",
    "ContentsIn",
    "CountersModel",
    "DeclarationModel",
    "EvaluationModel",
    "EventIn",
    "EventModel",
    "ExplainModel",
    "FieldModel",
    "HealthModel",
    "InsertionModel",
    "MatchIn",
    "MatchModel",
    "MatchesWhyModel",
    "OneDeclarationModel",
    "OntologyModel",
    "OntologyReportModel",
    "PartialMatchesModel",
    "PlanModel",
    "PortModel",
    "QualityIn",
    "QueryModel",
    "RematchModel",
    "RemovedModel",
    "RetentionModel",
    "SessionIn",
    "SessionModel",
    "Since",
    "SpecificationModel",
    "StatusModel",
    "Strategy",
    "StreamIn",
    "StreamModel",
    "SubscriptionIn",
    "SubscriptionModel",
    "TemplateModel",
    "TransformationIn",
    "TransformationModel",
    "UnitModel",
    "ViolationModel",
    "WaitingModel",
    "WhyModel",
    "WorthIn",
    "schema_of",
    "text_schema",
]
