"""The arithmetic of a training, and how many pictures go through at once, are the processor's, or the run's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from model import TrainConfig
from model.device import choose_machine, processor_way, training_dtype
from tests.helpers.driving import run_code

CPU = torch.device("cpu")
HAS_BFLOAT16 = any(torch.cpu.get_capabilities().get(name) for name in ("avx512_bf16", "amx_bf16", "bf16"))
BEGUN = {"device": "cpu", "arithmetic": "float32", "micro_batch": 7, "threads": 2, "torch": "2.13.0"}


@pytest.mark.parametrize(
    ("capabilities", "arithmetic", "micro_batch"),
    [
        ({"avx2": True, "avx512_f": True, "amx_bf16": True, "avx512_bf16": True}, "bfloat16", 128),  # Xeon, 2023
        ({"avx2": True, "avx512_f": True, "amx_bf16": False, "avx512_bf16": True}, "bfloat16", 64),  # EPYC, 2022
        ({"avx2": True, "avx512_f": True, "amx_bf16": False, "avx512_bf16": False}, "float32", 64),  # Xeon, 2017
        ({"neon": True, "bf16": True}, "bfloat16", 64),
        ({}, "float32", 64),  # one that PyTorch knows nothing of
    ],
)
def test_the_way_of_each_kind_of_processor(
    capabilities: dict[str, object], arithmetic: str, micro_batch: int
) -> None:
    way = processor_way({"l2_cache_size": 2 << 20, "num_physical_cores": 2, **capabilities})
    assert (way.arithmetic, way.micro_batch) == (arithmetic, micro_batch)


def test_the_arithmetic_is_the_processors_unless_it_is_chosen() -> None:
    assert training_dtype("auto", CPU) == (torch.bfloat16 if HAS_BFLOAT16 else torch.float32)
    assert training_dtype("float32", CPU) == torch.float32
    assert training_dtype("bfloat16", CPU) == torch.bfloat16
    before = torch.get_num_threads()
    try:
        machine = choose_machine(TrainConfig(device="cpu", precision="bfloat16", micro_batch=5, threads=1))
        assert (machine.device, machine.arithmetic, machine.micro_batch) == (CPU, "bfloat16", 5)
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)


def test_what_was_begun_goes_on_as_it_was_begun() -> None:
    auto = TrainConfig(device="cpu")
    assert choose_machine(auto, begun=BEGUN).arithmetic == "float32"
    assert choose_machine(auto, begun=BEGUN).micro_batch == 7
    before = choose_machine(auto, begun={**BEGUN, "arithmetic": "bfloat16"})
    assert before.arithmetic == ("bfloat16" if HAS_BFLOAT16 else "float32")  # as far as it has it
    assert before.micro_batch == 7
    machine = choose_machine(TrainConfig(device="cpu", precision="bfloat16", micro_batch=5), begun=BEGUN)
    assert (machine.arithmetic, machine.micro_batch) == ("bfloat16", 5)


@pytest.mark.parametrize(
    "begun",
    [
        None,
        "cpu",
        {"device": "cpu"},
        {**BEGUN, "device": "cuda"},  # as many at once as a GPU is given would be slow here
        {**BEGUN, "micro_batch": 0},
        {**BEGUN, "micro_batch": "7"},
        {**BEGUN, "arithmetic": "float64"},
    ],
)
def test_what_does_not_say_how_it_was_begun_goes_on_as_this_machine_does(begun: Any) -> None:
    auto = TrainConfig(device="cpu")
    assert choose_machine(auto, begun=begun) == choose_machine(auto)


@pytest.mark.skipif(
    not Path("/sys/kernel/mm/transparent_hugepage").exists(), reason="this system has no large pages"
)
def test_a_training_asks_for_large_pages() -> None:
    done = run_code(
        "import contextlib, sys; from model.cli import main; sys.argv = ['bc-train', '--help']\n"
        "with contextlib.suppress(SystemExit): main()\n"
        "import torch; pictures = torch.ones(8 << 20)\n"
        "flags = [line.split() for line in open('/proc/self/smaps') if line.startswith('VmFlags:')]\n"
        "print(any('hg' in line for line in flags))\n"
    )
    assert done.stdout.endswith("\nTrue\n"), done.stderr
