# docker build -t phdtrack . && docker run --rm -v "$PWD:/work" phdtrack track street.mp4
FROM python:3.12-slim

WORKDIR /opt/phdtrack
COPY pyproject.toml README.md LICENSE ./
COPY src src
RUN pip install --no-cache-dir '.[all]'

# Kernels are compiled here once for all users; another kind of processor compiles them again.
ENV NUMBA_CACHE_DIR=/var/cache/phdtrack
RUN python -c "from phdtrack import Tracker; Tracker(frame_size=(1920, 1080)).warm_up()" \
    && chmod -R a+rwX /var/cache/phdtrack

WORKDIR /work
ENTRYPOINT ["phdtrack"]
CMD ["--help"]
