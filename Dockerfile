# The programs `calib` and `medrue`, without a Python of your own:
#   docker build -t medrue .
#   docker run --rm -v "$PWD":/data medrue calib fit robot.yaml measurements.csv --out result
FROM python:3.12-slim
COPY requirements.txt /tmp/requirements.txt
RUN pip install --no-cache-dir --quiet -r /tmp/requirements.txt
COPY pyproject.toml README.md LICENSE /src/
COPY calib /src/calib
COPY viz /src/viz
COPY medrue /src/medrue
COPY urdf /src/urdf
COPY docs/examples /src/docs/examples
RUN pip install --no-cache-dir --quiet hatchling && pip install --no-cache-dir --quiet --no-deps --no-build-isolation /src
WORKDIR /data
CMD ["medrue", "demo", "--out", "demo"]
