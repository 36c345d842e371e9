"""The service that the tests share: its processes take seconds of computing to start."""

import pytest
from fastapi.testclient import TestClient
from services import settings_for

from drapenet.service.app import create_app


@pytest.fixture(scope="session")
def client(tmp_path_factory, untrained_checkpoint):
    results = tmp_path_factory.mktemp("results")
    app = create_app(settings_for(results, f"checkpoint={untrained_checkpoint}"))
    with TestClient(app, base_url="http://localhost") as client:
        yield client
