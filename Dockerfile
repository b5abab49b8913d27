# docker build -t phdtrack . && docker run --rm -v "$PWD:/work" --user "$(id -u)" phdtrack track VIDEO
FROM python:3.12-slim

WORKDIR /opt/phdtrack
COPY pyproject.toml README.md LICENSE ./
COPY src src
RUN pip install --no-cache-dir '.[all,opencv]'

# Kernels are compiled here once for all users; another kind of processor compiles them again.
ENV NUMBA_CACHE_DIR=/var/cache/phdtrack
RUN phdtrack warm-up && chmod -R a+rwX /var/cache/phdtrack

# Files in /work belong to this user, unless --user names another.
RUN useradd --uid 1000 phdtrack && install -d -o phdtrack /work
USER phdtrack
WORKDIR /work
# The page of live, with --host 0.0.0.0 --port 8080.
EXPOSE 8080
ENTRYPOINT ["phdtrack"]
CMD ["--help"]
