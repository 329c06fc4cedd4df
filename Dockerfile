# SPDX-License-Identifier: MIT
# docker build -t salsanext .                               CPU
# docker build -t salsanext:cuda --build-arg TORCH_INDEX=   CUDA: torch from the default index
# docker build -t salsanext:ray --build-arg EXTRAS=fuse,las,ray,ros .    for nodes of a Ray cluster
#   KubeRay asks with wget whether they are ready.
# docker run --rm -v "$PWD:/data" salsanext predict /data/velodyne /data/out
FROM python:3.12-slim
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
ARG EXTRAS=fuse,las,ros
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libusb-1.0-0 libgl1 libgomp1 libx11-6 wget \
    && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN pip install --no-cache-dir ${TORCH_INDEX:+--index-url "$TORCH_INDEX"} "torch>=2.4" \
    && pip install --no-cache-dir "/source[$EXTRAS]" \
    && rm -rf /source \
    && useradd --create-home salsanext \
    && mkdir /cache /data \
    && chown salsanext /cache /data
USER salsanext
# Compiled kernels and graphs, kept between runs in a volume.
ENV XDG_CACHE_HOME=/cache
VOLUME /cache
WORKDIR /data
ENTRYPOINT ["salsanext"]
CMD ["--help"]
