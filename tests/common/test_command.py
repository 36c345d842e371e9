"""Commands: settings, words, sweeps by Hydra, one line for a mistake."""

import subprocess
import sys
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import Field

import common.configs
import common.sweeps
import serve
from apps.capture import CaptureConfig
from apps.drape import DrapeConfig
from common.command import command, commands, compose_config
from common.configs import group_options, read_config, read_option
from common.errors import InputError
from data.dataset import generate
from data.dataset.config import Options
from data.dataset.hem import HemConfig
from data.dataset.inspect import InspectConfig
from data.dataset.off_axis import OffAxisConfig
from data.dataset.reading import ReadingConfig
from data.fabrics.prior.__main__ import FitConfig
from drapenet.config import EvaluateConfig, ExportConfig, InferConfig, ServeConfig, TrainConfig
from drapenet.library import LibraryConfig

ROOT = Path(__file__).parents[2]
SCHEMAS = {"capture": CaptureConfig, "drape": DrapeConfig, "evaluate": EvaluateConfig,
           "export": ExportConfig, "generate": Options,
           "hem": HemConfig, "infer": InferConfig, "inspect": InspectConfig,
           "library": LibraryConfig, "off_axis": OffAxisConfig, "prior_fit": FitConfig,
           "reading": ReadingConfig, "serve": ServeConfig, "train": TrainConfig}


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
    flag: bool
    inner: Inner
    out: str


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A command with the settings of ``Words`` that writes a file to its ``out``; called with
    arguments, it returns the settings of each job.
    """
    (tmp_path / "words.yaml").write_text(
        "name: a\nnames: ''\nnumbers: [1.0]\n"
        "count: 1  # of things\nflag: true\ninner: {text: b, number: 0.0}\nout: outputs/words\n")
    for module in (common.sweeps, common.configs):
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


@pytest.mark.parametrize("name", SCHEMAS)
def test_schema_and_file_have_the_same_commented_keys_and_every_default_fits_its_type(name):
    groups = {group for default in read_config(name).get("defaults", ())
              if isinstance(default, dict) for group in default}

    def same(schema: type, content: dict, groups: set[str]) -> None:
        kinds = {field.name: field.type for field in fields(schema) if field.init}
        assert kinds.keys() == (content.keys() | groups) - {"defaults", "hydra", "launcher"}
        for key, kind in kinds.items():
            if is_dataclass(kind) and key not in groups:
                same(kind, content[key], set())

    same(SCHEMAS[name], read_config(name), groups)
    assert isinstance(compose_config(name, [], schema=SCHEMAS[name]), SCHEMAS[name])
    keys = {field.name for field in fields(SCHEMAS[name])} - groups
    assert not any(map(group_options, keys))  # Hydra would take the key for a choice of a group
    for line in common.configs.config_text(name).splitlines():
        key = line.partition(":")[0]
        if key in read_config(name) and key not in ("defaults", "hydra", "port", "model", "optim"):
            assert "#" in line


def test_options_of_groups_are_read_as_they_stand():
    assert read_option("sensor", "tof")["model"] == "time_of_flight"
    assert "smooth" in group_options("sensor")
    with pytest.raises(InputError, match="sensor=kinect is unknown; known sensors: none"):
        read_option("sensor", "kinect")


@pytest.mark.parametrize("text", [
    "café 1", "a=b", "a,b", "$a$ and $$", "it's", "'a'b", "\\'", "a\\", "a\\\\", "\\\\'\\", "[a]",
    "{a}", "(a)", "a:b", "007", "null", "true", "~a", "a#b", " a", "*", "%(x)s", "", "日本", "1e5"])
def test_a_text_is_taken_as_it_is_written(run, text):
    (words,) = run(f"name={text}", f"inner.text={text}")
    assert words.name == words.inner.text == text


def test_a_path_may_begin_at_the_home_folder(run, monkeypatch):
    monkeypatch.setenv("HOME", "/home/me")
    (words,) = run("name=~/drapes", "inner.text='~/a'")
    assert (words.name, words.inner.text) == ("/home/me/drapes", "~/a")


@pytest.mark.parametrize(("text", "number"), [("03", 3.0), ("-004.5", -4.5), ("1e0", 1.0)])
def test_numbers_are_decimal(run, tmp_path, text, number):
    """On the command line and in files of settings."""
    (words,) = run(f"inner.number={text}")
    assert words.inner.number == number
    file = tmp_path / "words.yaml"
    file.write_text(file.read_text().replace("number: 0.0", f"number: {text}"))
    (words,) = run()
    assert words.inner.number == number


@pytest.mark.parametrize("text", ["1:03", "0x3", "0o3"])
def test_other_numbers_are_refused(run, tmp_path, text):
    with pytest.raises(InputError, match="inner.number='?" + text):
        run(f"inner.number={text}")
    file = tmp_path / "words.yaml"
    file.write_text(file.read_text().replace("number: 0.0", f"number: {text}"))
    with pytest.raises(InputError, match=f"inner.number='?{text}"):
        run()


def test_lists_and_interpolations(run):
    texts = ["A", "Köper", "my fabrics/twill 12", "Bob's (2)#3", "C:\\a b\\", "007", "日本", "x=y"]
    assert run(f"names=[{','.join(texts)}]")[0].names == texts
    assert run("names=[ A , 'b, c',${count}/ä]")[0].names == ["A", "b, c", "1/ä"]
    assert run("names=[]")[0].names == []
    (words,) = run("name=a b", "names=['a, b',\"c\"]", "numbers=1,2.5", "inner.text=${count} x")
    assert (words.name, words.names) == ("a b", ["a, b", "c"])
    assert words.numbers == [1.0, 2.5] and words.inner.text == "1 x"
    assert run("numbers=[3,4]")[0].numbers == [3.0, 4.0]
    assert run("names=['it\\'s',C:\\]")[0].names == ["it's", "C:\\"]
    assert run("name='a, b'", "numbers=5")[0].numbers == [5.0]


def test_a_text_that_hydra_cannot_read_in_a_sweep_is_answered_with_quotes(run):
    with pytest.raises(InputError, match=r"cannot be read; put .* as \"names='Köper'\""):
        run("-m", "names=Köper,b")
    jobs = run("-m", "name='Köper',b", "hydra.sweep.dir=logs")
    assert [job.name for job in jobs] == ["Köper", "b"]


@pytest.mark.parametrize(("words", "complaint"), [
    (["cuont=1"], "cuont"),
    (["+cuont=1"], "cuont"),
    (["inner.txt=a"], "inner.txt"),
    (["count"], "count"),
    (["count=1.5"], "count=1.5"),
    (["count=1001"], "count=1001.*1000"),
    (["inner.number=-5"], "inner.number=-5"),
    (["count=1,2"], "count"),
    (["~count"], "count"),
    (["inner.text=${nowhere}"], "nowhere"),
    (["numbers=[1,x]"], "numbers.1='x'"),
    (["numbers=[1,nan]"], "numbers.1='nan'"),
    (["flag=maybe"], "flag='maybe'"),
    (["--config-dir", "/nowhere"], "/nowhere"),
    (["-cn", "nothing"], "nothing.yaml"),
    (["-m", "count=2,x"], "count='x'"),
])
def test_a_mistake_is_one_line_and_nothing_is_called(run, words, complaint):
    with pytest.raises(InputError, match=complaint) as refusal:
        run(*words)
    assert "\n" not in str(refusal.value) and "Exception" not in str(refusal.value)


@pytest.mark.parametrize(("main", "word"), [
    (serve.main, "workers=1000000"),
    (serve.main, "port=high"),
    (generate.main, "~dataset.starts")])
def test_settings_out_of_range_are_refused_before_a_file_is_written(
    tmp_path, monkeypatch, main, word
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as refusal:
        main([word])
    assert "\n" not in str(refusal.value) and not list(tmp_path.iterdir())


def test_the_first_word_chooses_among_commands(capsys):
    called: list[list[str]] = []
    main = commands({"fit": called.append, "draw": called.append}, usage="How to fit.")
    main(["fit", "a=1", "--help"])
    main(["--help"])
    assert called == [["a=1", "--help"]] and capsys.readouterr().out == "How to fit.\n"
    for words in ([], ["draw2"]):
        with pytest.raises(InputError, match="one of: fit, draw"):
            main(words)


def test_options_of_hydra_and_help_answer_instead_of_the_command(run, capsys):
    assert run("flag=false", "--cfg", "job", "count=3") == []
    assert "count: 3" in capsys.readouterr().out
    assert run("count=3", "--help") == []
    text = capsys.readouterr().out
    assert text.startswith("Commands: settings, words")  # this module's docstring
    assert "count: 1  # of things" in text and "defaults" not in text


def test_help_lists_the_options_of_groups(capsys):
    generate.main(["-h"])
    text = capsys.readouterr().out
    assert "\ndrapes: 512" in text and "both_faces" in text and "nuisances=none" in text


def test_a_folder_of_the_users_adds_settings(run, tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "big.yaml").write_text("defaults: [words, _self_]\ncount: 1000\n")
    (words,) = run("--config-dir", str(folder), "-cn", "big", "flag=false")
    assert (words.count, words.flag, words.name) == (1000, False, "a")


def test_one_run_leaves_nothing_behind_and_each_job_of_a_sweep_has_its_out(run, tmp_path):
    before = sorted(tmp_path.iterdir())
    run("count=2")
    assert sorted(tmp_path.iterdir()) == before and Path.cwd() == tmp_path
    jobs = run("-m", "count=1,2", "name=a,b", "inner.text=x_${count}", "hydra.sweep.dir=logs")
    assert [(job.count, job.name, job.inner.text) for job in jobs] == [
        (1, "a", "x_1"), (1, "b", "x_1"), (2, "a", "x_2"), (2, "b", "x_2")]
    assert [Path(job.out) for job in jobs] == [tmp_path / "logs" / str(k) for k in range(4)]
    assert [job.out for job in run("-m", "count=1,2", "out=x/${count}")] == ["x/1", "x/2"]


def test_a_group_of_one_command_is_chosen_by_it_alone(run, tmp_path):
    folder = tmp_path / "words" / "inner"
    folder.mkdir(parents=True)
    for name, number in (("low", -1), ("high", 2)):
        (folder / f"{name}.yaml").write_text(f"text: {name}\nnumber: {number}\n")
    assert [word.inner.text for word in run("-m", "+inner=low,high", "hydra.sweep.dir=logs")] == [
        "low", "high"]
    assert run("inner.text=a")[0].inner.text == "a"


def test_parts_of_a_dataset_share_its_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    parts = []
    monkeypatch.setattr(generate, "generate_dataset", lambda config, out, **options: parts.append(
        (str(out), options["part"])) or {"complete": False})
    generate.main(["-m", "parts=3", "hydra.sweep.dir=logs"])
    generate.main(["-m", "parts=9", "part=3,7", "out=x", "hydra.sweep.dir=logs"])
    assert parts == [*(("outputs/dataset", k) for k in range(3)), ("x", 3), ("x", 7)]


def test_a_program_error_keeps_its_traceback_and_its_type(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["x"])

    def broken(config: ServeConfig) -> None:
        raise ZeroDivisionError("no number")

    with pytest.raises(ZeroDivisionError) as error:
        command("serve", ServeConfig)(broken)([])
    assert error.traceback[-1].name == "broken"


@pytest.mark.parametrize("script", ["infer.py", "train.py", "serve.py"])
def test_mistakes_and_help_do_not_wait_for_torch(script):
    code = ("import sys, runpy; sys.argv = sys.argv[1:]\ntry:\n"
            "    runpy.run_path(sys.argv[0], run_name='__main__')\n"
            "except SystemExit as end:\n"
            "    print(end.code or 0, [name for name in ('torch', 'open3d', 'fastapi')\n"
            "                     if name in sys.modules])")
    done = subprocess.run([sys.executable, "-c", code, script, "nonsense=1"], cwd=ROOT,
                          capture_output=True, text=True)
    assert done.stdout == "2 []\n" and done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1 and "nonsense" in done.stderr


@pytest.mark.parametrize(("words", "message"), [
    (["outputs/twill"], "^outputs/twill: write KEY=VALUE without spaces"),
    (["name=my", "fabrics/twill"], "^fabrics/twill: write KEY=VALUE .* 'KEY=MY VALUE'"),
    (["--name", "x"], "^--name: write name=VALUE, without dashes"),
    (["--name=x"], "^--name=x: write name=VALUE"), (["-sc"], "^-sc is not taken")])
def test_a_word_that_is_no_setting_is_answered_with_the_form(run, words, message):
    with pytest.raises(InputError, match=message):
        run(*words)
