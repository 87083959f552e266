# The command line in a container:
#
#     docker build -t tensegrity-mj .
#     docker run --rm -v "$PWD:/work" tensegrity-mj run prism --out prism.nc --video prism.mp4
FROM python:3.12-slim

# Off-screen OpenGL, for videos and pictures (scripts/setup.sh has the same packages).
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0 \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY tensegrity_mj tensegrity_mj
COPY controllers controllers
COPY models models
COPY scripts/compile_ahead.py scripts/
# Machine code for any processor of this architecture goes into the package, so that no container compiles anything.
RUN python -m pip install --no-cache-dir ".[web,data,studies,allocation,fatigue,ntrt,completion]" && python scripts/compile_ahead.py --ship && rm -rf /source

WORKDIR /work
ENTRYPOINT ["tensegrity-mj"]
CMD ["--help"]
