#!/bin/sh
# Installs PyTorch without CUDA libraries, 5 GB less, on Linux without an NVIDIA driver:
#     sh tools/cpu_torch.sh .venv/bin/python
# If PyTorch's own index does not answer within seconds, nothing is installed, and the next step takes
# the packages of the default index.
python=$1
[ "$(uname -s)" = Linux ] || exit 0
command -v nvidia-smi >/dev/null && exit 0
[ -e /proc/driver/nvidia ] && exit 0
"$python" -c 'import torch' 2>/dev/null && exit 0
"$python" -m pip install -qq --no-deps --timeout 4 --retries 0 --constraint constraints.txt \
  --index-url https://download.pytorch.org/whl/cpu torch torchvision 2>/dev/null \
  || echo "PyTorch's CPU packages are not at hand; taking those of the default index"
exit 0
