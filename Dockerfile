# The workbench with every extra for users; docs/workbench.md has the commands.
FROM rust:1.95-slim-bookworm AS wheel
# What builds the wheel may have any version; what runs has the versions of the lock.
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends make python3-venv
WORKDIR /source
COPY . .
RUN make wheel && grep -o '^[^ #]*==[^ ]*' requirements.lock > dist/constraints.txt

FROM python:3.11-slim-bookworm
RUN --mount=type=bind,from=wheel,source=/source/dist,target=/dist \
    pip install --no-cache-dir --constraint /dist/constraints.txt \
      "$(ls /dist/*.whl)[bags,cluster,hdf5,plot,serve]" \
    && useradd --create-home --uid 1000 strainwave \
    && install --directory --owner strainwave /rigs
USER 1000
WORKDIR /rigs
EXPOSE 8765
ENTRYPOINT ["strainwave"]
CMD ["serve", "/rigs", "--host", "0.0.0.0"]
