# docker build -t statebook . && docker run --rm -p 127.0.0.1:8888:8888 statebook
FROM python:3.12-slim
RUN useradd --create-home reader
USER reader
WORKDIR /home/reader/statebook
ENV PATH=/home/reader/.local/bin:$PATH OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
COPY --chown=reader requirements.txt .
RUN grep -v ^toppra requirements.txt > others.txt \
    && pip install --user --no-cache-dir --requirement others.txt
# toppra has wheels for x86-64 only; elsewhere all but the chapters that time paths is here.
RUN pip install --user --no-cache-dir "$(grep ^toppra requirements.txt)" || echo "without toppra"
COPY --chown=reader . .
RUN pip install --user --no-cache-dir --editable . --editable lib/nbregress \
    && python -m statebook.grading.students mine \
    && python -m nbformat.sign mine/*.ipynb mine/*/*.ipynb
EXPOSE 8888
CMD ["jupyter", "lab", "--ip=0.0.0.0", "--no-browser", "mine/00_start_here.ipynb"]
