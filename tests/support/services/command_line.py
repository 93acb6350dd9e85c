"""Commands of `dyknow`, run in this process."""

from typer.testing import CliRunner

from dyknow.service.cli import app


def run(*arguments, status=0):
    """What a command gives that ends with ``status``."""
    result = CliRunner().invoke(app, [str(each) for each in arguments])
    assert result.exit_code == status, (result.output, result.exception)
    return result
