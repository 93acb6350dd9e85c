"""stub"""


class SynchronizationUnit: ...
