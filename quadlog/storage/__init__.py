"""Where recordings and runs lie: paths of this machine, and addresses of object storage and web servers."""
