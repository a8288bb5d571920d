"""A policy file holds a small network and nothing else: everything beyond is refused before it runs."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from machine.errors import PolicyError
from runtime.control.policy_file import MAX_FILE_BYTES, OPERATORS, check_policy_file
from tests.cases import each

ROOT = Path(__file__).parents[3]


def model(*nodes: onnx.NodeProto, tensors: list[onnx.TensorProto] | None = None) -> onnx.ModelProto:
    weights = numpy_helper.from_array(np.ones((3, 2), np.float32), "w")
    graph = helper.make_graph(
        list(nodes) or [helper.make_node("MatMul", ["observation", "w"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", 3])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", 2])],
        [weights] if tensors is None else tensors,
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])


def external() -> onnx.ModelProto:
    tensor = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[3, 2])
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="weights.bin")
    return model(tensors=[tensor])


def shaped(*dims: int) -> onnx.ModelProto:
    return model(tensors=[TensorProto(name="w", data_type=TensorProto.FLOAT, dims=dims)])


def looped() -> onnx.ModelProto:
    body = model().graph
    return model(helper.make_node("Loop", ["n", "c"], ["action"], body=body))


def with_constant() -> onnx.ModelProto:
    value = numpy_helper.from_array(np.ones(4, np.float32))
    return model(helper.make_node("Identity", ["observation"], ["action"], value=value))


def with_function() -> onnx.ModelProto:
    made = model()
    made.functions.add(name="f", domain="own")
    return made


def with_operator_sets(*sets: tuple[str, int]) -> onnx.ModelProto:
    made = model()
    del made.opset_import[:]
    made.opset_import.extend(helper.make_opsetid(*one) for one in sets)
    return made


def test_shipped_policies_and_plain_networks_are_taken() -> None:
    for path in sorted((ROOT / "policies").glob("*/policy.onnx")):
        check_policy_file(path.read_bytes(), path.parent.name)
    check_policy_file(model().SerializeToString(), "plain")


@each(
    ("made", "cause"),
    [
        (external, "outside of the file"),
        (lambda: shaped(100_000, 100_000), "shape"),
        (lambda: shaped(2, 2, 2), "shape"),
        (lambda: shaped(-1, 2), "shape"),
        (looped, "operator 'Loop'"),
        (lambda: model(helper.make_node("ConstantOfShape", ["s"], ["action"])), "ConstantOfShape"),
        (lambda: model(helper.make_node("Add", ["a"], ["b"], domain="own")), "operator"),
        (lambda: model(*[helper.make_node("Add", ["a", "a"], ["b"])] * 65), "65 nodes"),
        (with_constant, "brings a tensor"),
        (with_function, "operators of its own"),
        (lambda: with_operator_sets(("", 9)), "operator set 9, taken are 13 to 22"),
        (lambda: with_operator_sets(("", 17), ("own", 1)), "operator set 'own'"),
        (lambda: with_operator_sets(), "names no operator set"),
    ],
)
def test_what_is_more_than_a_small_network_is_refused(made, cause: str) -> None:
    with pytest.raises(PolicyError, match=cause):
        check_policy_file(made().SerializeToString(), "hostile")


def test_noise_and_huge_files_are_refused() -> None:
    for content in (b"\xff" * 100, bytes(MAX_FILE_BYTES + 1), b"\x3a\xff\xff\xff\xff\x0f"):
        with pytest.raises(PolicyError):
            check_policy_file(content, "noise")


def test_a_graph_given_twice_is_checked_twice() -> None:
    hidden = model(helper.make_node("Expand", ["a", "s"], ["b"]))
    with pytest.raises(PolicyError, match="Expand"):
        check_policy_file(model().SerializeToString() + hidden.SerializeToString(), "twice")


def test_no_operator_makes_its_output_larger_than_its_inputs() -> None:
    growing = {
        "Expand",
        "Tile",
        "Concat",
        "ConstantOfShape",
        "Range",
        "Pad",
        "Resize",
        "Loop",
        "Scan",
    }
    assert not OPERATORS & growing


def test_a_file_that_also_reads_as_the_other_format_is_refused() -> None:
    prefix = b"\x7a\x06__ORTM"
    with pytest.raises(PolicyError, match="own format"):
        check_policy_file(prefix + model().SerializeToString(), "polyglot")
    check_policy_file(prefix.replace(b"M", b"_") + model().SerializeToString(), "plain")


def test_a_node_with_many_inputs_is_refused() -> None:
    check_policy_file(model(helper.make_node("Max", ["a"] * 8, ["b"])).SerializeToString(), "eight")
    with pytest.raises(PolicyError, match="operator Max has 9 inputs, at most 8 are taken"):
        check_policy_file(
            model(helper.make_node("Max", ["a"] * 9, ["b"])).SerializeToString(), "nine"
        )
