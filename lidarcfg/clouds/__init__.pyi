from .cloud import PointCloud as PointCloud
from .cloud import concatenate as concatenate
from .cloud import load_cloud as load_cloud
from .cloud import save_clouds as save_clouds
