# What every process of a run needs: docker build -t otc-dist:0.1.0 .
# With CUDA: docker build --build-arg TORCH=https://download.pytorch.org/whl/cu126 -t otc-dist:0.1.0-cuda .
FROM python:3.11-slim
ARG TORCH=https://download.pytorch.org/whl/cpu
# g++ compiles the updates where there is no GPU.
RUN apt-get update && apt-get install -y --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/otc-dist
COPY . .
RUN python -m pip install --no-cache-dir --extra-index-url "$TORCH" -c constraints.txt .
WORKDIR /data
ENTRYPOINT []
CMD ["otc-dist", "--help"]
