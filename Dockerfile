# docker build -t phdtrack . && docker run --rm -v "$PWD:/work" phdtrack track VIDEO
FROM python:3.12-slim

WORKDIR /opt/phdtrack
COPY pyproject.toml README.md LICENSE ./
COPY src src
RUN pip install --no-cache-dir '.[all]'

# Kernels are compiled here once for all users; another kind of processor compiles them again.
ENV NUMBA_CACHE_DIR=/var/cache/phdtrack
RUN phdtrack warm-up && chmod -R a+rwX /var/cache/phdtrack

WORKDIR /work
ENTRYPOINT ["phdtrack"]
CMD ["--help"]
