"""What a policy's ONNX file may hold: a small network in one file, bounded in size, memory and time.

Only operators whose output is no larger than their inputs allow are taken, tensors have at most two axes of
bounded length, and no tensor may lie outside the file: its hash would not cover it.
The wire format is read with the few fields of onnx.proto3 that matter here; protobuf skips the others.
"""

import math
from typing import Any, Final

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from machine.errors import PolicyError

MAX_FILE_BYTES: Final = 8 * 1024 * 1024
"""A shipped policy has 0.2 MB."""
OPERATOR_SETS: Final = range(13, 23)
"""Versions of ONNX's operator set; exports use 17, and the allowed operators are the same in all of these."""
MAX_NODE_COUNT: Final = 64
MAX_INPUT_COUNT: Final = 8
"""Of one node; exports use at most three."""
MAX_AXIS_COUNT: Final = 2
MAX_LENGTH_COUNT: Final = 1024
"""Of one axis of a tensor."""
OPERATORS: Final = frozenset(
    {
        "Abs",
        "Add",
        "Clip",
        "Div",
        "Elu",
        "Exp",
        "Gemm",
        "Identity",
        "LeakyRelu",
        "MatMul",
        "Max",
        "Min",
        "Mul",
        "Neg",
        "Relu",
        "Selu",
        "Sigmoid",
        "Softplus",
        "Sqrt",
        "Sub",
        "Tanh",
    }
)
"""Elementwise operators and matrix products; nothing that makes shapes, loops or draws random numbers."""

_FIELD = descriptor_pb2.FieldDescriptorProto
_INT64, _STRING, _MESSAGE, _INT32 = (
    _FIELD.TYPE_INT64,
    _FIELD.TYPE_STRING,
    _FIELD.TYPE_MESSAGE,
    _FIELD.TYPE_INT32,
)
_MESSAGES: Final[dict[str, tuple[tuple[str, int, int, str], ...]]] = {
    "Tensor": (
        ("dims", 1, _INT64, ""),
        ("name", 8, _STRING, ""),
        ("external_data", 13, _MESSAGE, "Entry"),
        ("data_location", 14, _INT32, ""),
    ),
    "Entry": (("key", 1, _STRING, ""),),
    "Attribute": (
        ("name", 1, _STRING, ""),
        ("t", 5, _MESSAGE, "Tensor"),
        ("g", 6, _MESSAGE, "Graph"),
        ("tensors", 10, _MESSAGE, "Tensor"),
        ("graphs", 11, _MESSAGE, "Graph"),
    ),
    "Node": (
        ("input", 1, _STRING, ""),
        ("op_type", 4, _STRING, ""),
        ("attribute", 5, _MESSAGE, "Attribute"),
        ("domain", 7, _STRING, ""),
    ),
    "Graph": (
        ("node", 1, _MESSAGE, "Node"),
        ("initializer", 5, _MESSAGE, "Tensor"),
        ("sparse_initializer", 15, _MESSAGE, "Entry"),
    ),
    "OperatorSet": (("domain", 1, _STRING, ""), ("version", 2, _INT64, "")),
    "Model": (
        ("graph", 7, _MESSAGE, "Graph"),
        ("opset_import", 8, _MESSAGE, "OperatorSet"),
        ("functions", 25, _MESSAGE, "Entry"),
    ),
}
"""Message -> its fields: name, number in onnx.proto3, type, message. All are repeated: protobuf lets a
single field be read so, and a file that gives one twice hides nothing."""


def _model_class() -> Any:
    file = descriptor_pb2.FileDescriptorProto(
        name="downrange/policy_file.proto", package="downrange.policy", syntax="proto3"
    )
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for field, number, kind, of in fields:
            message.field.add(
                name=field,
                number=number,
                type=kind,
                label=_FIELD.LABEL_REPEATED,
                type_name=f".downrange.policy.{of}" if of else None,
            )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("downrange.policy.Model"))


_MODEL: Final = _model_class()


def check_policy_file(content: bytes, name: str) -> None:
    """Refuse a file that is more than a small network.

    Args:
        content: the whole file.
        name: for the error's text.

    Raises:
        PolicyError: with what is not allowed.
    """
    if len(content) > MAX_FILE_BYTES:
        raise PolicyError(f"{name} has {len(content)} bytes, at most {MAX_FILE_BYTES} are taken")
    # A network in onnxruntime's own format, which may also read as ONNX with other operators.
    if content[4:8] == b"ORTM":
        raise PolicyError(f"{name} is in onnxruntime's own format; export it as ONNX")
    try:
        model = _MODEL.FromString(content)
    except DecodeError as error:
        raise PolicyError(f"{name} is not a usable ONNX file ({error}); copy it again") from error
    if model.functions:
        raise PolicyError(f"{name} defines operators of its own; export it without")
    _check_operator_sets(model, name)
    nodes = [node for graph in model.graph for node in graph.node]
    if len(nodes) > MAX_NODE_COUNT:
        raise PolicyError(f"{name} has {len(nodes)} nodes, at most {MAX_NODE_COUNT} are taken")
    for node in nodes:
        _check_node(node, name)
    for graph in model.graph:
        if graph.sparse_initializer:
            raise PolicyError(f"{name} holds sparse tensors; export it with dense ones")
        for tensor in graph.initializer:
            _check_tensor(tensor, name)


def _check_operator_sets(model: Any, name: str) -> None:
    low, high = OPERATOR_SETS[0], OPERATOR_SETS[-1]
    for used in model.opset_import:
        domain = (used.domain or [""])[-1]
        if domain not in ("", "ai.onnx"):
            raise PolicyError(
                f"{name} uses operator set {domain[:40]!r}; only ONNX's own one is taken"
            )
        if any(version not in OPERATOR_SETS for version in used.version):
            raise PolicyError(
                f"{name} uses operator set {used.version[-1]}, taken are {low} to {high}"
            )
    if not any(used.version for used in model.opset_import):
        raise PolicyError(f"{name} names no operator set, taken are {low} to {high}")


def _check_node(node: Any, name: str) -> None:
    operator = "/".join([*node.op_type])
    if operator not in OPERATORS or any(node.domain):
        raise PolicyError(
            f"{name} uses operator {operator[:40]!r}, allowed are {', '.join(sorted(OPERATORS))}"
        )
    if len(node.input) > MAX_INPUT_COUNT:
        raise PolicyError(
            f"{name}: operator {operator} has {len(node.input)} inputs, at most {MAX_INPUT_COUNT} are taken"
        )
    for attribute in node.attribute:
        if attribute.g or attribute.graphs or attribute.t or attribute.tensors:
            raise PolicyError(f"{name}: operator {operator} brings a tensor or graph of its own")


def _check_tensor(tensor: Any, name: str) -> None:
    what = f"{name}: tensor {(tensor.name[0] if tensor.name else '')[:40]!r}"
    if tensor.external_data or any(tensor.data_location):
        raise PolicyError(f"{what} lies outside of the file; export it with its weights inside")
    dims = [*tensor.dims]
    if len(dims) > MAX_AXIS_COUNT or any(not 0 <= n <= MAX_LENGTH_COUNT for n in dims):
        raise PolicyError(
            f"{what} has shape {dims[:8]} ({math.prod(dims[:8])} numbers), at most {MAX_AXIS_COUNT} axes "
            f"of {MAX_LENGTH_COUNT} are taken"
        )
