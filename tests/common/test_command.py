"""Commands as Hydra applications: words, complaints, options of Hydra's own."""

import re
import subprocess
import sys
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import Field

import common.command
import common.configs
import serve
import train
from apps import drape
from apps.cantilever import EstimateConfig, HangConfig
from apps.drape import DrapeConfig
from common.command import (
    _swept_out,
    command,
    commands,
    compose_config,
    describe,
    groups_of,
    keys_of,
    to_hydra,
)
from common.configs import group_options, read_config, read_option
from common.errors import InputError
from data.captures.preview import CaptureConfig
from data.dataset import generate
from data.dataset.inspect.__main__ import InspectConfig
from data.dataset.options import Options, config_from_options
from data.fabrics.prior.__main__ import FitConfig
from drapenet.config import EvaluateConfig, ExportConfig, InferConfig, TrainConfig
from drapenet.export.hinges import HingesConfig
from drapenet.service.settings import Settings
from drapenet.views.specimen_offset import PlacementConfig

ROOT = Path(__file__).parents[2]
SCHEMAS = {"cantilever_estimate": EstimateConfig, "cantilever_hang": HangConfig,
           "capture": CaptureConfig, "drape": DrapeConfig, "evaluate": EvaluateConfig,
           "export": ExportConfig, "generate": Options, "hinges": HingesConfig,
           "infer": InferConfig, "inspect": InspectConfig, "placement": PlacementConfig,
           "prior_fit": FitConfig, "serve": Settings, "train": TrainConfig}


@dataclass
class Inner:
    text: str
    number: Annotated[float, Field(gt=-5, lt=5)]


@dataclass
class Words:
    name: str
    names: Any
    numbers: list[float]
    count: Annotated[int, Field(ge=0, le=1000)]
    seed: int
    ratio: float
    flag: bool
    inner: Inner


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A command with the settings of ``Words``; given words, it returns what it was called with."""
    (tmp_path / "words.yaml").write_text(
        "defaults: [words_schema, command, _self_]\nname: a\nnames: ''\nnumbers: [1.0]\n"
        "count: 1  # of things\nseed: 0\nratio: 1.0\nflag: true\ninner: {text: b, number: 0.0}\n")
    (tmp_path / "command.yaml").write_text(
        (common.configs.CONFIG_DIR / "command.yaml").read_text())
    for module in (common.command, common.configs):
        monkeypatch.setattr(module, "CONFIG_DIR", tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["words"])
    called: list[Words] = []

    @command("words", Words)
    def main(words: Words) -> None:
        called.append(words)

    def answer(*words: str) -> list:
        called.clear()
        main(list(words))
        return called

    return answer


# --- Settings -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCHEMAS)
def test_schema_and_file_have_the_same_keys_and_every_default_fits_its_type(name):
    def same(schema: type, content: dict, groups: set[str]) -> None:
        kinds = {field.name: field.type for field in fields(schema)}
        assert kinds.keys() == (content.keys() | groups) - {"defaults", "hydra", "launcher"}
        for key, kind in kinds.items():
            if is_dataclass(kind) and key not in groups:
                same(kind, content[key], set())

    same(SCHEMAS[name], read_config(name), groups_of(name).keys())
    settings = compose_config(name, [], schema=SCHEMAS[name])
    assert isinstance(settings, SCHEMAS[name])


def test_groups_and_values_are_overridden():
    config = compose_config("generate", ["dataset=paper", "seed=3"], schema=Options)
    assert config.dataset.starts_per_fabric == 8 and config.dataset.drapes_per_shard == 64
    assert config.seed == 3 and config.drapes == 512


def test_files_are_read_as_they_stand():
    assert read_option("camera", "square300_cylinder100")["camera"]["width"] == 240
    assert read_config("generate")["drapes"] == 512
    assert "smooth" in group_options("sensor")
    with pytest.raises(InputError, match="unknown sensor 'kinect'; known sensors: none"):
        read_option("sensor", "kinect")


# --- Words ----------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [
    "café 1", "a=b", "a,b", "$a$ and $$", "it's", '"a"b', "'a'b", "\\'", "a\\", "a\\\\", "\\\\'\\",
    "[a]", "{a}", "(a)", "a:b", "007", "null", "true", "~a", "a#b", " a", "?", "*", "%(x)s", "",
    "line\nbreak", "日本", "a;b", "$(pwd)", "1e5", "@x", "---"])
def test_a_text_is_taken_as_it_is_written(run, text):
    listed = not {",", "'", '"', " "} & {*text, text[:1]}
    names = [text, text] if listed else text
    word = f"names=[{text},{text}]" if listed else f"names={text}"
    (words,) = run(f"name={text}", f"inner.text={text}", word)
    assert words.name == words.inner.text == text and words.names == names


def test_quotes_lists_and_other_keys_are_hydras(run):
    (words,) = run("name='a, b'", "names=['a, b',\"c\"]", "numbers=1,2.5", "inner.text=${count} x")
    assert (words.name, words.names) == ("a, b", ["a, b", "c"])
    assert words.numbers == [1.0, 2.5] and words.inner.text == "1 x"
    assert run("numbers=[3,4]")[0].numbers == run("numbers=3,4")[0].numbers == [3.0, 4.0]
    assert run("numbers=5")[0].numbers == [5.0]
    assert to_hydra("hydra.job.name=x y", Words) == "hydra.job.name=x y"


@pytest.mark.parametrize(("words", "complaint"), [
    (["cuont=1,2"], "^unknown key 'cuont', perhaps count; known keys: count, flag, inner, name"),
    (["nane=a"], r"unknown key 'nane', perhaps name; known keys: count, flag, inner, name"),
    (["inner.txt=a"], "unknown key 'inner.txt', perhaps text; keys of inner: number, text"),
    (["count"], "'count' is not of the form key=value"),
    (["--count=3"], "unrecognized arguments: --count=3; --hydra-help"),
    (["--cfg", "jobs"], "--cfg"),
    (["count=1.5"], "^count=1.5 must be a whole number, such as 3$"),
    (["count=1001"], "^count=1001 is outside 0-1000$"),
    (["inner.number=-5"], "^inner.number=-5.0 must be more than -5$"),
    (["count=1,2"], "takes one value; --multirun runs a job for each"),
    (["count=1", "count=2"], "count= is given 2 times"),
    (["count=1", "+count=2"], "count= is given 2 times"),
    (["seed=12345678901234567890123"], "seed=12345678901234567890123 must not be above"),
    (["name=${nowhere}"], "nowhere"),
    (["numbers=[1,x]"], r"numbers\[1\]=x must be a finite number, such as 3"),
    (["numbers=[1,nan]"], "numbers=nan must be a finite number"),
    (["ratio=inf"], "^ratio=inf must be a finite number, such as 3$"),
    (["flag=maybe"], "flag=maybe must be true or false"),
    (["inner.number=-.inf"], "inner.number=-.inf must be a finite number"),
    (["~count"], "count"),
    (["--run", "--multirun"], "Only one of --run, --multirun"),
    (["--config-dir", "/nowhere"], "'/nowhere' not found"),
    (["-cn", "nothing"], "nothing"),
    (["-m", "name=a b,c'"], "name"),
])
def test_a_mistake_is_one_line_and_nothing_is_called(run, words, complaint):
    with pytest.raises(InputError, match=complaint) as refusal:
        run(*words)
    text = str(refusal.value)
    assert "\n" not in text and "Exception" not in text and "to append" not in text.lower()


@pytest.mark.parametrize(
    ("name", "word", "complaint"),
    [
        ("generate", "dataset=null", "dataset=null"),
        ("generate", "dataset=[1]", "see dataset=[1]"),
        ("generate", "dataset=huge", "specimens"),
        ("generate", "dataset.colour=red", "keys of dataset: both_faces, drapes_per_shard"),
        ("generate", "nuisances.colour=red", "keys of nuisances"),
        ("generate", "colour=red", "unknown key 'colour'; known keys: dataset, drapes, edge_mm"),
        ("generate", "+colour=red", "unknown key 'colour'; known keys: dataset"),
        ("generate", "=3", "=3"),
        ("train", "optim.colour=red", "unknown key 'optim.colour'; keys of optim: batch_size"),
        ("train", "setup=rea", "real"),
        ("serve", "port=high", "port=high must be a whole number"),
    ],
)
def test_complaints_about_the_groups(name, word, complaint):
    with pytest.raises(InputError) as refusal:
        compose_config(name, [word], schema=SCHEMAS[name])
    text = str(refusal.value)
    assert complaint in text and "\n" not in text and "Exception" not in text
    assert "_type" not in text and "+" not in text  # classes; the advice to append keys


@pytest.mark.parametrize(
    "word",
    ["rig=moon", "~dataset", "~dataset.starts", "dataset.starts=null", "~nuisances.shear",
     "nuisances.cut_deg=wide"],
)
def test_values_that_make_no_sense(word):
    with pytest.raises(InputError) as refusal:
        config_from_options(compose_config("generate", [word], schema=Options))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("words", "complaint"), [
    (["alpha=0.00005,0.00005,0.00005"], "alpha=5e-05 .*µN·m; check the unit"),
    (["density=0.3"], "density=0.3 .*g/m²; check the unit"),
    (["alpha=1,1,1", "alpha=2,2,2"], "alpha= is given 2 times"),
    (["alpha=[1,x,2]"], "alpha"), (["out="], "out= is empty; give the name of a folder"),
])
def test_wrong_units_are_refused_before_the_drape(tmp_path, monkeypatch, words, complaint):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=complaint):
        drape.main(words)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("main", "word"), [
    (train.main, "threads=100000000"), (train.main, "workers=1000000"),
    (generate.main, "workers=1000000"), (serve.main, "workers=1000000"),
    (generate.main, "seed=-12345678901234567890123")])
def test_absurd_counts_are_refused(tmp_path, monkeypatch, main, word):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=word.partition("=")[0]):
        main([word])
    assert not list(tmp_path.iterdir())


def test_the_first_word_is_the_value_of_a_key_unless_it_sets_one(run):
    called: list[Words] = []
    main = command("words", Words, first="name")(called.append)
    for words in (["a b"], ["n=1"], ["/x.y/count=2"], ["name=c"], ["count=2"], ["++count=2"],
                  ["hydra.job.name=d"], ["e", "count=2"]):
        main(words)
    assert [(one.name, one.count) for one in called] == [
        ("a b", 1), ("n=1", 1), ("/x.y/count=2", 1), ("c", 1), ("a", 2), ("a", 2), ("a", 1),
        ("e", 2)]
    with pytest.raises(InputError, match="'b' is not of the form key=value"):
        main(["a", "b"])


def test_the_first_word_chooses_among_commands(capsys):
    called: list[list[str]] = []
    main = commands({"fit": called.append, "draw": called.append}, usage="How to fit.")
    main(["fit", "a=1", "--help"])
    main(["--help"])
    assert called == [["a=1", "--help"]] and capsys.readouterr().out == "How to fit.\n"
    for words, complaint in (([], "^no command; the first word is one of: fit, draw"),
                             (["draw2"], "^unknown command 'draw2', perhaps draw; ")):
        with pytest.raises(InputError, match=complaint):
            main(words)


# --- Hydra's own ----------------------------------------------------------------------------


def test_options_of_hydra_answer_instead_of_the_command(run, capsys):
    assert run("--cfg", "job", "count=3") == []
    assert "count: 3" in capsys.readouterr().out
    assert run("--info", "searchpath") == []
    assert "Config search path" in capsys.readouterr().out
    with pytest.raises(SystemExit) as ending:
        run("--help")
    assert ending.value.code in (0, None)
    said = capsys.readouterr().out
    assert "Commands as Hydra applications" in said  # this module's docstring
    assert "count: 1  # of things" in said and "defaults" not in said


def test_a_folder_of_the_users_adds_settings(run, tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "big.yaml").write_text("defaults: [words, _self_]\ncount: 1000\n")
    (words,) = run("--config-dir", str(folder), "-cn", "big", "seed=7")
    assert (words.count, words.seed, words.name) == (1000, 7, "a")


def test_one_run_leaves_nothing_behind_and_a_sweep_its_folder(run, tmp_path, capsys):
    before = sorted(tmp_path.iterdir())
    run("count=2")
    assert sorted(tmp_path.iterdir()) == before and Path.cwd() == tmp_path
    found = run("-m", "count=1,2", "name=a,b", "inner.text=x_${count}",
                f"hydra.sweep.dir={tmp_path / 'logs'}")
    assert [(one.count, one.name, one.inner.text) for one in found] == [
        (1, "a", "x_1"), (1, "b", "x_1"), (2, "a", "x_2"), (2, "b", "x_2")]
    assert (tmp_path / "logs" / "multirun.yaml").exists() and Path.cwd() == tmp_path


@pytest.fixture
def made(run, tmp_path):
    """A command that writes a file to its ``out``; given words, all files in its folder."""
    file = tmp_path / "words.yaml"
    file.write_text(file.read_text() + "out: outputs/words\n")

    @dataclass
    class Made(Words):
        out: str

    @command("words", Made)
    def main(words: Made) -> None:
        folder = Path(words.out or ".")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "made.txt").write_text(f"{words.count} {words.name}")

    def answer(*words: str) -> dict[str, str]:
        main([*words, "hydra.sweep.dir=sweep"])
        return {str(file.relative_to(tmp_path)): file.read_text()
                for file in sorted(tmp_path.rglob("made.txt"))}

    return answer


def test_each_job_of_a_sweep_has_its_own_folder(made):
    assert made("-m", "count=1,2") == {"sweep/0/made.txt": "1 a", "sweep/1/made.txt": "2 a"}
    assert "outputs/words/made.txt" in made("count=5")


@pytest.mark.parametrize(("words", "places"), [
    (["count=1,2", "out=x/${count}"], ["x/1", "x/2"]),
    (["count=1,2", "name=b,c", "out=x/${hydra:job.num}"], ["x/0", "x/1", "x/2", "x/3"]),
    (["count=1", "out=x"], ["x"]), (["out=x,y"], ["x", "y"])])
def test_a_sweep_with_places_of_its_own_leaves_no_empty_folder(made, tmp_path, words, places):
    assert list(made("-m", *words)) == [f"{place}/made.txt" for place in places]
    assert [file.name for file in (tmp_path / "sweep").iterdir()] == ["multirun.yaml"]


@pytest.mark.parametrize(("words", "remedy"), [
    (["count=1,2", "out=x"], "give 'out=x/${count}', or no out="),
    (["inner.number=1,2", "out=x"], "give 'out=x/${inner.number}'"),
    (["numbers=[1],[2]", "out=x"], "give 'out=x/${hydra:job.num}'"),
    (["count=1,2", "name=b,c", "out=x/${name}"], "the same for all values of count"),
    (["count=1,2", "out=x,y"], "the same for all values of count")])
def test_jobs_that_would_overwrite_each_other_are_refused(made, tmp_path, words, remedy):
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError, match=re.escape(remedy)):
        made("-m", *words)
    assert sorted(tmp_path.iterdir()) == before


def test_parts_of_a_dataset_share_its_folder():
    for words in ([], ["part=3,7"], ["launcher=joblib", "out=x"]):
        assert _swept_out("generate", words, None) is None
    assert _swept_out("generate", ["seed=1,2"], None) == "."
    assert _swept_out("infer", ["refine=none,depth"], ".") == "."
    assert _swept_out("prior_fit", ["model=vae1,vae2"], None) == "prior.json"
    assert _swept_out("export", ["to=usd,jfab"], None) is None  # beside the estimate


def test_a_program_error_keeps_its_traceback_and_its_type(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["x"])

    def broken(config: Settings) -> None:
        raise ZeroDivisionError("no number")

    with pytest.raises(ZeroDivisionError) as error:
        command("serve", Settings)(broken)([])
    assert error.traceback[-1].name == "broken"


def test_help_lists_the_keys_of_alternatives_where_they_are_others():
    said = describe("infer", "How to infer.")
    assert all(f"    {key}: " in said for key in ("by", "starts", "coarse_mm", "edge_mm"))
    said = describe("generate", "")
    assert "drapes_per_shard" in said and "n_jobs" not in said  # a launcher is Hydra's


@pytest.mark.parametrize("script", ["infer.py", "train.py", "serve.py"])
def test_wrong_words_and_help_do_not_wait_for_torch(script):
    code = ("import sys, runpy; sys.argv = sys.argv[1:]\ntry:\n"
            "    runpy.run_path(sys.argv[0], run_name='__main__')\n"
            "except SystemExit as end:\n"
            "    print(end.code or 0, [name for name in ('torch', 'open3d', 'fastapi')\n"
            "                     if name in sys.modules])")
    asked = {word: subprocess.Popen([sys.executable, "-c", code, script, word], cwd=ROOT,
                                    stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
             for word in ("--help", "nonsense=1")}
    out, error = asked["--help"].communicate()
    assert out.splitlines()[-1] == "0 []" and not error
    out, error = asked["nonsense=1"].communicate()
    assert out == "2 []\n" and error.startswith("error: unknown key 'nonsense'")
    assert error.count("\n") == 1


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_key_has_a_comment(name):
    text = common.configs.config_text(name)
    for key in keys_of(name, SCHEMAS[name]) - groups_of(name).keys() - {"port", "model", "optim"}:
        (line,) = [line for line in text.splitlines() if line.startswith(f"{key}:")]
        assert "#" in line, line


