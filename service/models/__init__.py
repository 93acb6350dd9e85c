"""The JSON models of requests and responses, by resource. Times are ISO-8601 in UTC, durations are
texts such as ``5s``."""

from .annotations import AnnotationModel
from .events import (
    EventIn,
    EventModel,
    ParameterModel,
    PlanModel,
    RunningUnitModel,
    StepModel,
    TemplateModel,
    UnitModel,
)
from .graph import GraphModel
from .kpl import DeclarationModel, OneDeclarationModel, RemovedModel
from .matching import MatchIn, MatchModel
from .objects import ListedObjectsModel, ObjectModel
from .parts import BEGINNING, Since, Strategy, schema_of, text_schema
from .queries import QueryModel
from .reasoning import MatchesWhyModel, PartialMatchesModel, WhyModel
from .session import SessionIn, SessionModel
from .specifications import InsertionModel, SpecificationModel
from .state import (
    CheckpointModel,
    ExplainModel,
    FeatureModel,
    FindingModel,
    HealthModel,
    HttpRequestModel,
    JournalModel,
    LoadModel,
    LogLineModel,
    LogModel,
    OntologyModel,
    OntologyReportModel,
    SettingModel,
    SortModel,
    StageModel,
    StatusModel,
    TrialModel,
    ViolationModel,
    VocabularyModel,
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
    "CheckpointModel",
    "ContentsIn",
    "CountersModel",
    "DeclarationModel",
    "EvaluationModel",
    "EventIn",
    "EventModel",
    "ExplainModel",
    "FeatureModel",
    "FieldModel",
    "FindingModel",
    "GraphModel",
    "HealthModel",
    "HttpRequestModel",
    "InsertionModel",
    "JournalModel",
    "ListedObjectsModel",
    "LoadModel",
    "LogLineModel",
    "LogModel",
    "MatchIn",
    "MatchModel",
    "MatchesWhyModel",
    "ObjectModel",
    "OneDeclarationModel",
    "OntologyModel",
    "OntologyReportModel",
    "ParameterModel",
    "PartialMatchesModel",
    "PlanModel",
    "PortModel",
    "QualityIn",
    "QueryModel",
    "RematchModel",
    "RemovedModel",
    "RetentionModel",
    "RunningUnitModel",
    "SessionIn",
    "SessionModel",
    "SettingModel",
    "Since",
    "SortModel",
    "SpecificationModel",
    "StageModel",
    "StatusModel",
    "StepModel",
    "Strategy",
    "StreamIn",
    "StreamModel",
    "SubscriptionIn",
    "SubscriptionModel",
    "TemplateModel",
    "TransformationIn",
    "TransformationModel",
    "TrialModel",
    "UnitModel",
    "ViolationModel",
    "VocabularyModel",
    "WaitingModel",
    "WhyModel",
    "WorthIn",
    "schema_of",
    "text_schema",
]
