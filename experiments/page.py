"""Sections of experiments that repeat those of papers, and their page docs/studies.md."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from experiments.figures.claims import slug
from experiments.result import ROOT, Report, table

PAGE = ROOT / "docs" / "studies.md"
ORDER = ("table3", "repeatability", "robustness", "views", "transfer", "hung", "skirt")
"""Experiments in the order of the page."""
_HEAD = """# Studies

Experiments of published papers, repeated with this system. The command of a study resumes after an
interruption and writes its section of this page; `make studies` runs all studies, and
`python -m experiments page` writes page and figures from the stored reports. Unless stated
otherwise, errors of log α and β/α are root mean squares of posterior mean minus truth, in units of
the standard deviation over fabrics, and displacements are distances between the positions of the
same material point in two drapes, averaged over the specimen including its part on the plate. 002
is Feng et al. 2022, 000 Larionov et al., 001 DiffCloth, 004 Miguel et al. 2012.
[validation.md](validation.md) validates and times the simulator.
[The last section](#networks-and-searches) has figures of studies that are no experiments any more.
"""
_TAIL = """## Networks and searches

What the papers ask of networks is asked of `train.py`, by its settings, on any dataset of
`data.dataset.generate`; `python -m drapenet.network.evaluate checkpoint=FILE` compares the results.
The figures here are of small networks that another trainer made in minutes, of 844 fabrics in one
drape each, and are errors of log α.

- **Inputs, backbones** (002, Figure 20, Table 2): after 90 s of processor time 0.29 from the map
  of all views (0.27 million parameters), 0.34 from the boundary curve, 0.54 from drape coefficient
  and folds, 0.71 from four stacked views by ResNet-18; ResNet-34, AlexNet, EfficientNet-B0 and
  VGG-16 had learned nothing (1.00 to 1.01). The paper's ResNet-18, trained for 12.7 hours, has
  0.127. `python train.py data=DATA model=views` trains the paper's network, `model.backbone=vgg16`
  another of its table, `inputs=[depth]`, `inputs=[outline]` and `inputs=[numbers]` a network of
  maps.
- **Outputs** (002, Figure 18, Eq. 10): 0.36 for the mean of a posterior, 0.38 for a regression,
  0.44 for the best classification (8 to 64 classes); 70 % of the moduli were inside the
  posterior's intervals of 68 %. `model.output=regression`, `model.output=posterior`.
- **Amount of data** (002, section 5.2): 0.41, 0.35, 0.35, 0.35 from 105, 211, 422, 844 fabrics;
  0.36, 0.36, 0.36 from one, two, four drapes of each of 199 fabrics; 0.42, 0.35, 0.32 after 100,
  400, 1 600 steps. `fabrics=105`, `drapes=2`, `epochs=60`.
- **Fabrics** (002, section 7.5): 0.36 from fabrics of the autoencoder, 0.33 of a mixture of three
  Gaussians, 0.37 of a box around them; the best linear law (β = 0) lay 0.5 mm (median) from the
  drape that it was fitted to, and 0.9 mm from one of another start. `prior=gaussian` of
  `data.dataset.generate`.
- **Starts and orientations** (002, Figures 22 and 23): a network of maps trained on one kind of
  start varied by 11.6 % between drapes of a fabric, one trained on three kinds by 9.4 %; a network
  of stacked views trained in one orientation varied by 45.5 % over orientations, in any by 17.9 %.
  `dataset.starts=[sine]` of `data.dataset.generate`.
- **Identification without a network** (000, Figure 7): the nearest of 96 drapes was of the same
  fabric for 56 % by drape coefficient and folds, 79 % by mean height and curvature, 74 % by the
  spectrum on a grid, 81 % by that along rings, 95 % by the network's α, 3 % by chance.
- **Searches on drapes of other simulators** (001, section 6; 000, section 5): with all vertices
  known, Levenberg–Marquardt found α to 11 % in 8 simulations, CMA-ES to 16 % in 60, L-BFGS-B to 34
  % in 12; from a drape of hinges 19, 27 and 41 %, from Newton's Style3D, which has no β, 39, 35
  and 49 %.
"""


@dataclass(frozen=True)
class Section:
    """Section of the page: texts, and functions of the report.

    Attributes:
        source: paper and section of the repeated experiment.
        question: in one sentence.
        summary: the main results in sentences.
        rows: header and rows of the table.
        paper: results of the paper, and whether they are comparable.
        limits: of the validity of the results.
        inputs: of each method, where they differ.
    """

    title: str
    source: str
    question: str
    summary: Callable[[Report], str]
    rows: Callable[[Report], tuple[Sequence[str], list[list[object]]]]
    draw: Callable[[Report], Figure]
    paper: str
    limits: str
    inputs: str = ""

    def text(self, name: str, report: Report) -> str:
        """The section of the experiment ``name``."""
        return "\n\n".join(filter(None, [
            f"## {self.title}", f"*Source*: {self.source}. {self.question} "
            f"*Command*: `python -m experiments {name}`.", self.summary(report),
            table(*self.rows(report)), f"![{self.title}](validation/{name}.png)",
            self.inputs and f"*Inputs*: {self.inputs}",
            f"*Paper*: {self.paper}", f"*Limits*: {self.limits}"]))


def page_text(sections: dict[str, Section], reports: dict[str, Report]) -> str:
    """Text of the page, from sections and reports by name."""
    contents = table(["study", "source"], [[f"[{section.title}](#{slug(section.title)})",
                                            section.source] for section in sections.values()])
    texts = [section.text(name, reports[name]) for name, section in sections.items()]
    return "\n".join([_HEAD, contents, "", "\n\n".join([*texts, _TAIL])])
