"""A network as the graph of an ONNX file, node by node, from PyTorch's trace of its layers (torch.fx).

Only a network whose layers are known here, and whose way through them does not depend on what it sees, has one.
ONNX is imported only here and in onnx_export.py.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import fx, nn
from torch.nn import functional

from common.named_function import in_one_line
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import STEERING_ONLY, TARGETS, TargetName
from model.errors import RunError
from model.network.picture_network import PictureNetwork
from model.network.pooling import sides
from model.onnx_camera import CROP, PICTURE, add_preprocessing
from model.runs.answer_scale import AnswerScale

if TYPE_CHECKING:
    from onnx import GraphProto

_ELEMENTWISE: Final[dict[Any, str]] = {
    nn.ReLU: "Relu",
    nn.Sigmoid: "Sigmoid",
    nn.Tanh: "Tanh",
    functional.relu: "Relu",
    torch.relu: "Relu",
    torch.sigmoid: "Sigmoid",
    torch.tanh: "Tanh",
    "relu": "Relu",
    "sigmoid": "Sigmoid",
    "tanh": "Tanh",
}
"""Layers, functions and methods of one tensor, and ONNX's operators that do the same."""
_OF_TWO: Final[dict[Any, str]] = {
    operator.add: "Add",
    operator.iadd: "Add",
    torch.add: "Add",
    operator.mul: "Mul",
    torch.mul: "Mul",
}
_UNCHANGED: Final = (nn.Dropout, nn.Dropout2d, nn.Identity)
_FLATTEN: Final[tuple[Any, ...]] = (torch.flatten, "flatten")
_RESHAPE: Final = ("view", "reshape")  # (N, -1) is flattening


def onnx_graph(
    network: PictureNetwork,
    answers: AnswerScale,
    picture: PictureSpec,
    targets: Sequence[TargetName] = STEERING_ONLY,
    *,
    of_camera: bool = False,
) -> GraphProto:
    """In: "pictures", uint8 (N, height, width, 3), or `of_camera` one "picture", uint8 RGB of any size; out, each
    float32 (N,): "steering", and other targets in their unit; `of_camera` also the "crop", uint8 (height, width,
    3). Raises RunError for a network that has no graph."""
    from onnx import TensorProto, helper, numpy_helper

    graph = Graph(network)
    height, width, _ = picture.shape
    if of_camera:
        inputs = helper.make_tensor_value_info(PICTURE, TensorProto.UINT8, ["height", "width", 3])
        crops = [helper.make_tensor_value_info(CROP, TensorProto.UINT8, [height, width, 3])]
        value = add_preprocessing(graph, picture)
    else:
        inputs = helper.make_tensor_value_info("pictures", TensorProto.UINT8, ["N", height, width, 3])
        crops = []
        value = graph.add("Transpose", "planes", "pictures", perm=[0, 3, 1, 2])
        value = graph.add("Cast", "levels", value, to=TensorProto.FLOAT)
    value = graph.add("Div", "halves", value, graph.constant("half_of_levels", np.array(127.5, np.float32)))
    value = graph.add("Sub", "scaled", value, graph.constant("one", np.array(1, np.float32)))
    value = graph.follow(value)
    for at, target in enumerate([TARGETS[name] for name in targets[1:]], 1):
        per_unit = graph.constant(f"{target.name}_per_unit", np.array(target.per_unit, np.float32))
        graph.add("Mul", target.answer_name, graph.column(f"{target.name}_learnt", value, at), per_unit)
    if len(targets) > 1:
        value = graph.column("steering_learnt", value, 0)
    if answers != AnswerScale():
        scale, curve, offset = (
            graph.constant(name, np.array(getattr(answers, name), np.float32))
            for name in ("scale", "curve", "offset")
        )
        size = graph.add("Abs", "size_of_answer", value)
        factor = graph.add("Add", "factor", graph.add("Mul", "bent", size, curve), scale)
        value = graph.add("Add", "natural", graph.add("Mul", "scaled_answer", value, factor), offset)
    if len(targets) == 1 and _answers_in_columns(network, picture):
        graph.add("Squeeze", "steering", value, graph.constant("axis", np.array([1], np.int64)))
    else:
        graph.add("Identity", "steering", value)
    count = 1 if of_camera else "N"
    names = [TARGETS[name].answer_name for name in targets]
    return helper.make_graph(
        graph.nodes,
        "steering",
        [inputs],
        [*(helper.make_tensor_value_info(name, TensorProto.FLOAT, [count]) for name in names), *crops],
        [numpy_helper.from_array(array, name) for name, array in graph.constants.items()],
    )


class Graph:
    """The nodes and constants of a graph that is being written."""

    def __init__(self, network: PictureNetwork) -> None:
        self.network = network
        self.nodes: list[Any] = []
        self.constants: dict[str, NDArray[Any]] = {}

    def add(self, operation: str, output: str, *inputs: str, **attributes: Any) -> str:
        from onnx import helper

        self.nodes.append(helper.make_node(operation, inputs, [output], output, **attributes))
        return output

    def constant(self, name: str, array: NDArray[Any]) -> str:
        self.constants[name] = array
        return name

    def integers(self, name: str, *numbers: int) -> str:
        return self.constant(name, np.array(numbers, np.int64))

    def column(self, output: str, value: str, number: int) -> str:
        """(N,) out of (N, K)."""
        at = self.constant(f"{output}_column", np.array(number, np.int64))
        return self.add("Gather", output, value, at, axis=1)

    def follow(self, inputs: str) -> str:
        """Add the network's own nodes, from its scaled inputs to its answers."""
        values: dict[fx.Node, str] = {}
        for node in _traced(self.network).nodes:
            if node.op == "placeholder":
                values[node] = inputs
            elif node.op == "output":
                answers = node.args[0]
                if not isinstance(answers, fx.Node) or answers not in values:
                    raise _UnknownPartError("its output")
                return values[answers]
            elif not _is_of_shape(node, values):
                values[node] = self._node(node, values)
        raise _UnknownPartError("its output")

    def _node(self, node: fx.Node, values: dict[fx.Node, str]) -> str:
        arguments = [values[each] for each in node.args if isinstance(each, fx.Node) and each in values]
        if node.op == "call_module":
            name = str(node.target)
            layer = self.network.get_submodule(name)
            if any(name in each.output for each in self.nodes):  # called before
                name = node.name
            return self._layer(name, layer, *arguments)
        name, operation, settings = node.name, node.target, (*node.args[1:], *node.kwargs.values())
        if not arguments or node.op == "get_attr":
            raise _UnknownPartError(str(getattr(operation, "__name__", operation)))
        if operation in _ELEMENTWISE and settings in ((), (False,), (True,)):  # in place or not
            return self.add(_ELEMENTWISE[operation], name, arguments[0])
        if operation in _OF_TWO and len(arguments) == 2 and len(settings) == 1:
            return self.add(_OF_TWO[operation], name, *arguments)
        is_reshaped = operation in _RESHAPE and len(settings) == 2 and repr(settings[1]) == "-1"
        if is_reshaped or (operation in _FLATTEN and settings == (1,)):
            return self.add("Flatten", name, arguments[0], axis=1)
        if operation == operator.getitem:  # of a shape
            return ""
        raise _UnknownPartError(str(getattr(operation, "__name__", operation)))

    def _layer(self, name: str, layer: nn.Module, value: str) -> str:
        if type(layer) in _ELEMENTWISE:
            return self.add(_ELEMENTWISE[type(layer)], name, value)
        if isinstance(layer, _UNCHANGED):
            return value
        match layer:
            case nn.Conv2d() if layer.padding_mode == "zeros" and isinstance(layer.padding, tuple):
                return self.add(
                    "Conv",
                    name,
                    *self._weighted(name, layer, value),
                    pads=[*layer.padding, *layer.padding],
                    strides=list(layer.stride),
                    dilations=list(layer.dilation),
                    group=layer.groups,
                )
            case nn.MaxPool2d() if not layer.return_indices and sides(layer.dilation) == (1, 1):
                padding = sides(layer.padding)
                return self.add(
                    "MaxPool",
                    name,
                    value,
                    kernel_shape=sides(layer.kernel_size),
                    strides=sides(layer.stride),
                    pads=padding * 2,
                    ceil_mode=int(layer.ceil_mode),
                )
            case nn.AdaptiveAvgPool2d() if layer.output_size in (1, (1, 1)):
                return self.add("GlobalAveragePool", name, value)
            case nn.BatchNorm2d() if layer.affine and layer.track_running_stats:
                kept = ("weight", "bias", "running_mean", "running_var")
                numbers = [self.constant(f"{name}.{each}", _numbers(getattr(layer, each))) for each in kept]
                return self.add("BatchNormalization", name, value, *numbers, epsilon=layer.eps)
            case nn.ELU():
                return self.add("Elu", name, value, alpha=float(layer.alpha))
            case nn.LeakyReLU():
                return self.add("LeakyRelu", name, value, alpha=float(layer.negative_slope))
            case nn.SiLU():
                return self.add("Mul", name, value, self.add("Sigmoid", f"{name}.gate", value))
            case nn.Flatten() if (layer.start_dim, layer.end_dim) == (1, -1):
                return self.add("Flatten", name, value, axis=1)
            case nn.Linear():
                return self.add("Gemm", name, *self._weighted(name, layer, value), transB=1)
        raise _UnknownPartError(str(layer))

    def _weighted(self, name: str, layer: nn.Conv2d | nn.Linear, value: str) -> list[str]:
        """A layer's inputs: the value, its weight, and its bias if it has one."""
        kept = [each for each in ("weight", "bias") if getattr(layer, each) is not None]
        return [value, *(self.constant(f"{name}.{each}", _numbers(getattr(layer, each))) for each in kept)]


def _is_of_shape(node: fx.Node, values: dict[fx.Node, str]) -> bool:
    """Whether a node gives a height, a width or the like: (N, -1) needs none of them."""
    of_values = [each for each in node.all_input_nodes if each in values]
    return (
        node.target == "size"
        or (node.target is getattr and node.args[1:] == ("shape",))
        or (node.target is operator.getitem and not of_values)
    )


class _UnknownPartError(RunError):
    def __init__(self, part: str) -> None:
        super().__init__(f"a part of its network cannot be written as ONNX: {part}")


def _traced(network: PictureNetwork) -> fx.Graph:
    tracer = fx.Tracer()
    tracer.traced_func_name = "answers"
    try:
        return tracer.trace(network)
    except Exception as error:  # of its own code, asked for what is only known of pictures
        raise RunError(
            f"its network cannot be written as ONNX: its way depends on what it sees ({in_one_line(error)})"
        ) from None


@torch.inference_mode()
def _answers_in_columns(network: PictureNetwork, picture: PictureSpec) -> bool:
    height, width, _ = picture.shape
    return network.answers(torch.zeros(2, 3, height, width)).dim() == 2


def _numbers(tensor: torch.Tensor) -> NDArray[np.float32]:
    found: NDArray[np.float32] = tensor.detach().numpy()
    return found
